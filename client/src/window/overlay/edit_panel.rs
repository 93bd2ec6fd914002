//! The panel of numbers of what is chosen.

use egui::{Align2, DragValue, RichText, Ui};
use glam::{DQuat, DVec3, EulerRot, Vec3};
use gnomon_client_core::edit::{Target, editor::LightAt, with_changes};
use gnomon_protocol::text::Escaped;
use gnomon_scene::{Edit, LightEdit, LightKind, NodeAt, NodeEdit};

use super::style::{BLUE, frame};
use crate::window::editing::Editing;

/// Most entries of the list; others are found with a click.
const MOST_LISTED: usize = 400;

/// Quaternions and directions that are farther apart are not those that were typed. The latter have gone through f32.
const SAME: f64 = 1e-6;

/// Angles as they were typed: other angles may give the same direction.
#[derive(Debug, Clone, Copy, Default)]
struct Typed {
    rotation: Option<(DQuat, [f64; 3])>,
    direction: Option<(DVec3, [f64; 2])>,
}

/// The overlay remembers them.
fn typed(ui: &Ui) -> Typed {
    ui.data(|data| data.get_temp(egui::Id::NULL)).unwrap_or_default()
}

fn remember(ui: &Ui, typed: Typed) {
    ui.data_mut(|data| data.insert_temp(egui::Id::NULL, typed));
}

/// Draws the panel, and changes what is chosen as the person wants.
pub(crate) fn show(context: &egui::Context, editing: &mut Editing) {
    egui::Area::new(egui::Id::unique("edit")).anchor(Align2::RIGHT_TOP, [-8.0, 8.0]).show(context, |ui| {
        frame().show(ui, |ui| {
            ui.set_width(230.0);
            history(ui, editing);
            list(ui, editing);
            let edit = match editing.editor.selected() {
                None => {
                    hint(ui, editing);
                    None
                }
                Some(Target::Node(node)) => node_rows(ui, editing, node),
                Some(Target::Light(light)) => light_rows(ui, editing, light),
            };
            if let (Some(edit), Some(seen)) = (edit, &editing.seen) {
                editing.edits.extend(editing.editor.change(&seen.latest.at, edit));
            }
        });
    });
    // Numbers are one step from the first change until they are let go.
    let busy = context.input(|input| input.pointer.any_down()) || context.text_edit_focused();
    if !busy && editing.editor.holds().is_none() {
        editing.editor.settle();
    }
}

fn history(ui: &mut Ui, editing: &mut Editing) {
    ui.horizontal(|ui| {
        ui.label(RichText::new("Edit").size(16.0).strong());
        let (can_undo, can_redo) = (editing.editor.history().can_undo(), editing.editor.history().can_redo());
        if ui.add_enabled(can_undo, egui::Button::new("undo")).on_hover_text("Ctrl+Z").clicked() {
            editing.undo();
        }
        if ui.add_enabled(can_redo, egui::Button::new("redo")).on_hover_text("Ctrl+Y, Ctrl+Shift+Z").clicked() {
            editing.redo();
        }
    });
}

fn list(ui: &mut Ui, editing: &mut Editing) {
    let editor = &editing.editor;
    // A file's names are a stranger's. A lamp often has its node's.
    let label = |target: Target| {
        let name = editor.stage.label(target);
        let kind = if matches!(target, Target::Light(_)) && !name.starts_with("light") { " (light)" } else { "" };
        format!("{}{kind}", Escaped(&name))
    };
    let mut chosen = editor.selected();
    let shown = chosen.map_or_else(|| "–".to_owned(), label);
    egui::ComboBox::from_id_salt("chosen").selected_text(shown).width(200.0).truncate().show_ui(ui, |ui| {
        let (lights, nodes): (Vec<_>, Vec<_>) =
            editor.stage.targets().partition(|target| matches!(target, Target::Light(_)));
        for target in lights.into_iter().chain(nodes).take(MOST_LISTED) {
            ui.selectable_value(&mut chosen, Some(target), label(target));
        }
    });
    if let Some(Target::Node(node)) = chosen
        && let Some(above) = editor.stage.above(node).map(Target::Node)
        && ui.button(format!("above: {}", label(above))).clicked()
    {
        chosen = Some(above);
    }
    editing.editor.select(chosen);
}

fn hint(ui: &mut Ui, editing: &Editing) {
    let has_nodes = editing.editor.stage.targets().any(|target| matches!(target, Target::Node(_)));
    ui.label(if has_nodes {
        "Click an object or a lamp, or choose one above."
    } else {
        "Click a lamp, or choose a light above. The scene was loaded without --editable, so objects stay."
    });
}

fn title(ui: &mut Ui, text: &str) {
    ui.label(RichText::new(text).color(BLUE));
}

/// A row of numbers. Returns whether one was changed.
fn numbers<const N: usize>(
    ui: &mut Ui,
    name: &str,
    values: &mut [f64; N],
    kind: impl Fn(DragValue<'_>) -> DragValue<'_>,
) -> bool {
    title(ui, name);
    let row = ui.horizontal(|ui| {
        let add = |value: &mut f64| one_number(ui, 70.0, value, &kind);
        values.iter_mut().map(add).fold(false, |any, changed| any | changed)
    });
    row.inner
}

/// A number. Returns whether it was changed.
fn one_number(ui: &mut Ui, width: f32, value: &mut f64, kind: impl Fn(DragValue<'_>) -> DragValue<'_>) -> bool {
    let (was, decimals) = (*value, decimals(*value));
    let shown = kind(DragValue::new(value).max_decimals(decimals));
    let changed = ui.add_sized([width, 18.0], shown).changed();
    // A click into the field and away again sets the value to the text shown, which is rounded. That is no change.
    let is_news = changed && (*value - was).abs() > 0.51 * 0.1_f64.powi(i32::try_from(decimals).unwrap_or(i32::MAX));
    if !is_news {
        *value = was;
    }
    is_news
}

/// Thousandths, or three digits of what is smaller.
fn decimals(value: f64) -> usize {
    (3..9)
        .find(|decimals| value == 0.0 || value.abs() * 10_f64.powi(*decimals) >= 100.0)
        .map_or(9, |decimals| usize::try_from(decimals).unwrap_or(9))
}

fn metres(value: DragValue<'_>) -> DragValue<'_> {
    value.speed(0.01)
}

fn degrees(value: DragValue<'_>) -> DragValue<'_> {
    value.speed(0.5).suffix("°")
}

fn node_rows(ui: &mut Ui, editing: &Editing, node: u32) -> Option<Edit> {
    let at = &editing.seen.as_ref()?.latest.at;
    let before: NodeAt = editing.editor.stage.scene().node_at(node, at)?;
    let edited = at.edits.node(node);
    let mut after = before;
    let mut place = before.translation_m.to_array();
    if numbers(ui, "position, m", &mut place, metres) {
        after.translation_m = place.into();
    }
    let typed_before = typed(ui).rotation.filter(|(known, _)| same_rotation(*known, before.rotation));
    let mut angles = typed_before.map_or_else(|| angles_of(before.rotation), |(_, angles)| angles);
    if numbers(ui, "rotation", &mut angles, degrees) {
        after.rotation = rotation_of(angles);
        remember(ui, Typed { rotation: Some((after.rotation, angles)), ..typed(ui) });
    }
    let mut scale = before.scale.to_array();
    // A hundredth of what it is, so that things in any unit grow alike.
    let speed = 0.01 * before.scale.abs().max_element().max(1e-6);
    if numbers(ui, "scale", &mut scale, |value| value.speed(speed)) {
        after.scale = scale.into();
    }
    ui.checkbox(&mut after.shown, "shown");
    if after.shown && !before.visible && before.shown {
        ui.label("hidden with one above");
    }
    let edit = with_changes(edited, &before, &after);
    let edit = if as_in_the_file(ui, edited != NodeEdit::default()) { NodeEdit::default() } else { edit };
    (edit != edited).then_some(Edit::Node(node, edit))
}

fn light_rows(ui: &mut Ui, editing: &Editing, number: u32) -> Option<Edit> {
    let posed = &editing.seen.as_ref()?.latest;
    let light = posed.lights.get(number as usize)?;
    let LightAt { kind, position_m, direction } = editing.editor.light_at(number, posed)?;
    let edited = posed.at.edits.light(number);
    let mut edit = edited;
    if kind != LightKind::Directional {
        let mut place = position_m.to_array();
        if numbers(ui, "position, m", &mut place, metres) {
            edit.position_m = Some(place.into());
        }
    }
    if kind != LightKind::Point {
        let typed_before = typed(ui).direction.filter(|(known, _)| known.distance(direction) < SAME);
        let mut angles = typed_before.map_or_else(|| heading_of(direction), |(_, angles)| angles);
        if numbers(ui, "shines: heading, height", &mut angles, degrees) {
            let direction = direction_of(angles);
            edit.direction = Some(direction);
            remember(ui, Typed { direction: Some((direction, angles)), ..typed(ui) });
        }
    }
    let unit = if kind == LightKind::Directional { "lx" } else { "cd" };
    let mut intensity = f64::from(light.intensity);
    title(ui, "brightness");
    ui.horizontal(|ui| {
        // A hundredth of what it is, so that lamps of any strength dim alike.
        let speed = intensity.max(1e-3) * 0.01;
        let dragged = one_number(ui, 110.0, &mut intensity, |value| {
            value.range(0.0..=f64::from(f32::MAX)).speed(speed).suffix(format!(" {unit}"))
        });
        let off = ui.add_enabled(light.intensity > 0.0, egui::Button::new("off")).clicked();
        if off {
            intensity = 0.0;
        }
        if dragged || off {
            #[expect(clippy::cast_possible_truncation, reason = "what lights have")]
            let intensity = intensity as f32;
            edit.intensity = Some(intensity);
        }
    });
    ui.horizontal(|ui| {
        title(ui, "colour");
        let mut color = light.color.to_array();
        if ui.color_edit_button_rgb(&mut color).changed() {
            edit.color = Some(Vec3::from_array(color));
        }
    });
    if as_in_the_file(ui, edited != LightEdit::default()) {
        edit = LightEdit::default();
    }
    (edit != edited).then_some(Edit::Light(number, edit))
}

fn as_in_the_file(ui: &mut Ui, is_edited: bool) -> bool {
    ui.add_enabled(is_edited, egui::Button::new("as in the file")).clicked()
}

fn same_rotation(one: DQuat, other: DQuat) -> bool {
    one.dot(other).abs() > 1.0 - SAME * SAME
}

/// Degrees around x, y and z, in the order y, x, z: yaw, then pitch, then roll.
fn angles_of(rotation: DQuat) -> [f64; 3] {
    let (y, x, z) = rotation.to_euler(EulerRot::YXZ);
    [x, y, z].map(in_degrees)
}

fn rotation_of(angles: [f64; 3]) -> DQuat {
    let [x, y, z] = angles.map(f64::to_radians);
    DQuat::from_euler(EulerRot::YXZ, y, x, z).normalize()
}

/// Degrees around up, from −z to the right, and above the horizon.
fn heading_of(direction: DVec3) -> [f64; 2] {
    [direction.x.atan2(-direction.z), direction.y.clamp(-1.0, 1.0).asin()].map(in_degrees)
}

/// What is next to nothing is shown as 0, not as −0.
fn in_degrees(angle_rad: f64) -> f64 {
    let angle = angle_rad.to_degrees();
    if angle.abs() < 1e-6 { 0.0 } else { angle }
}

fn direction_of(angles: [f64; 2]) -> DVec3 {
    let [heading, height] = angles.map(f64::to_radians);
    DVec3::new(heading.sin() * height.cos(), height.sin(), -heading.cos() * height.cos()).normalize()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn angles_give_back_what_they_are_of() {
        // A few roundings of sines and cosines; asin and acos lose half the digits near their ends.
        for rotation in [DQuat::IDENTITY, DQuat::from_xyzw(0.5, -0.5, 0.1, 0.7).normalize()] {
            assert!(same_rotation(rotation_of(angles_of(rotation)), rotation));
        }
        assert!(!same_rotation(DQuat::IDENTITY, DQuat::from_rotation_x(1e-4)));
        for direction in [DVec3::NEG_Y, DVec3::NEG_Z, DVec3::new(0.48, -0.6, 0.64)] {
            assert!(direction_of(heading_of(direction)).distance(direction) < 1e-7, "{direction}");
        }
        assert_eq!(heading_of(DVec3::X), [90.0, 0.0]);
    }

    #[test]
    fn small_numbers_show_three_digits() {
        for (value, expected) in [(0.0, 3), (12.5, 3), (0.1, 3), (-0.012_345_6, 4), (4e-4, 6), (1e-12, 9)] {
            assert_eq!(decimals(value), expected, "{value}");
        }
    }
}

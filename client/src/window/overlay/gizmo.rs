//! What stands over the picture while a person edits: lamps' markers, the outline of what is chosen, its handles.

use egui::{Align2, Color32, FontId, LayerId, Painter, Pos2, Stroke, vec2};
use glam::{DVec2, DVec3};
use gnomon_client_core::edit::{
    Target,
    handles::{Axis, Drawn, Handle},
};
use gnomon_scene::LightKind;

use super::style::{BACKGROUND, BLUE, GREEN, ORANGE, TEXT, VERMILLION};
use crate::window::editing::{Editing, Seen};

/// Radius of a lamp's marker, in points.
const MARKER: f32 = 6.0;

/// A dark edge around lines, so that they show on any picture.
const EDGE: Color32 = BACKGROUND;

/// Draws over the picture, below all panels.
pub(crate) fn show(context: &egui::Context, editing: &Editing) {
    let Some(seen) = &editing.seen else { return };
    let painter = context.layer_painter(LayerId::background());
    let selected = editing.editor.selected();
    if let Some(Target::Node(node)) = selected
        && let Some(corners) = editing.editor.stage.outline(node, &seen.posed)
    {
        outline(&painter, seen, &corners);
    }
    for (light, px) in editing.editor.lamps(&seen.view, &seen.posed) {
        let color = seen.posed.lights.get(light as usize).map_or(TEXT, |light| shown(light.color));
        marker(&painter, on_screen(seen, px), color, selected == Some(Target::Light(light)));
    }
    if let Some(Target::Light(light)) = selected {
        beam(&painter, editing, seen, light);
    }
    let active = editing.active();
    let handles = seen.gizmo.iter().flat_map(|gizmo| &gizmo.handles);
    // What is held is on top.
    let (top, below): (Vec<_>, Vec<_>) = handles.partition(|drawn| Some(drawn.handle) == active);
    for drawn in below.into_iter().chain(top) {
        handle(&painter, seen, drawn, Some(drawn.handle) == active);
    }
    if active.is_some() {
        let held = editing.editor.holds().is_some();
        context.set_cursor_icon(if held { egui::CursorIcon::Grabbing } else { egui::CursorIcon::Grab });
    }
}

fn on_screen(seen: &Seen, px: DVec2) -> Pos2 {
    seen.points(seen.fit.to_window(px))
}

/// A light's colour at its full strength, as a screen shows it.
fn shown(color: glam::Vec3) -> Color32 {
    let most = color.max_element().max(f32::MIN_POSITIVE);
    let [r, g, b] = (color / most).clamp(glam::Vec3::ZERO, glam::Vec3::ONE).to_array();
    egui::Rgba::from_rgb(r, g, b).into()
}

fn line(painter: &Painter, points: [Pos2; 2], width: f32, color: Color32) {
    painter.line_segment(points, Stroke::new(width + 2.0, EDGE));
    painter.line_segment(points, Stroke::new(width, color));
}

fn outline(painter: &Painter, seen: &Seen, corners: &[DVec3; 8]) {
    for from in 0..8_usize {
        for bit in [1, 2, 4] {
            let (true, Some(one), Some(other)) = (from & bit == 0, corners.get(from), corners.get(from | bit)) else {
                continue;
            };
            if let Some(ends) = seen.view.segment([*one, *other]) {
                line(painter, ends.map(|end| on_screen(seen, end)), 1.0, ORANGE);
            }
        }
    }
}

/// A lamp: a disc of its colour with eight rays.
fn marker(painter: &Painter, at: Pos2, color: Color32, selected: bool) {
    let rays = if selected { ORANGE } else { TEXT };
    for ray in 0..8_u8 {
        let (sin, cos) = (f32::from(ray) * std::f32::consts::FRAC_PI_4).sin_cos();
        let ends = [MARKER + 2.0, MARKER + 5.0].map(|radius| at + vec2(cos, sin) * radius);
        line(painter, ends, 1.5, rays);
    }
    painter.circle(at, MARKER, color, Stroke::new(2.0, EDGE));
    if selected {
        painter.circle_stroke(at, MARKER + 8.0, Stroke::new(2.0, ORANGE));
    }
}

/// Where a chosen light shines: an arrow to the middle of its handles, or from there.
fn beam(painter: &Painter, editing: &Editing, seen: &Seen, light: u32) {
    let (Some(gizmo), Some(light)) = (&seen.gizmo, editing.editor.light_at(light, &seen.posed)) else { return };
    let reach = light.direction * gizmo.radius_m * 1.4;
    let ends = match light.kind {
        LightKind::Point => return,
        LightKind::Spot { .. } => [gizmo.pivot, gizmo.pivot + reach],
        LightKind::Directional => [gizmo.pivot - reach, gizmo.pivot],
    };
    if let Some([from, to]) = seen.view.segment(ends).map(|ends| ends.map(|end| on_screen(seen, end))) {
        line(painter, [from, to], 2.0, ORANGE);
        tip(painter, from, to, ORANGE);
    }
}

fn tip(painter: &Painter, from: Pos2, to: Pos2, color: Color32) {
    let along = (to - from).normalized() * 11.0;
    let side = along.rot90() * 0.45;
    let corners = vec![to + along * 0.5, to - along * 0.5 + side, to - along * 0.5 - side];
    painter.add(egui::Shape::convex_polygon(corners, color, Stroke::new(1.0, EDGE)));
}

fn color_of(handle: Handle) -> (Color32, &'static str) {
    match handle {
        Handle::Move(Axis::X) | Handle::Turn(Axis::X) => (VERMILLION, "X"),
        Handle::Move(Axis::Y) | Handle::Turn(Axis::Y) => (GREEN, "Y"),
        Handle::Move(Axis::Z) | Handle::Turn(Axis::Z) => (BLUE, "Z"),
        Handle::Slide | Handle::Scale => (TEXT, ""),
    }
}

fn handle(painter: &Painter, seen: &Seen, drawn: &Drawn, active: bool) {
    let (color, name) = color_of(drawn.handle);
    let color = if active { Color32::WHITE } else { color };
    let width = if active { 4.0 } else { 2.0 };
    match (drawn.handle, &drawn.points[..]) {
        (Handle::Move(_), [(from, _), (to, _)]) => {
            let (from, to) = (on_screen(seen, *from), on_screen(seen, *to));
            line(painter, [from, to], width, color);
            tip(painter, from, to, color);
            let at = to + (to - from).normalized() * 16.0;
            let font = FontId::proportional(14.0);
            painter.text(at + vec2(1.0, 1.0), Align2::CENTER_CENTER, name, font.clone(), Color32::BLACK);
            painter.text(at, Align2::CENTER_CENTER, name, font, color);
        }
        (Handle::Turn(_), points) => {
            for [(from, behind), (to, _)] in points.array_windows() {
                let color = if *behind && !active { color.gamma_multiply(0.35) } else { color };
                let ends = [*from, *to].map(|px| on_screen(seen, px));
                painter.line_segment(ends, Stroke::new(width, color));
            }
        }
        (Handle::Slide, [(at, _)]) => {
            let radius = if active { 8.0 } else { 6.0 };
            painter.circle(on_screen(seen, *at), radius, color, Stroke::new(1.5, EDGE));
        }
        (Handle::Scale, [(at, _)]) => {
            let square = egui::Rect::from_center_size(on_screen(seen, *at), vec2(12.0, 12.0));
            painter.rect(square, 2.0, color, Stroke::new(1.5, EDGE), egui::StrokeKind::Outside);
        }
        _ => {}
    }
}

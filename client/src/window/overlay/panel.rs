//! The panel of figures and settings, the notice, the labels of a split picture, and the help.

use egui::{Align2, RichText};
use gnomon_protocol::text::Escaped;

use super::{
    figures::{Figures, Now},
    graphs,
    style::{BACKGROUND, BLUE, ORANGE, TEXT, frame},
};
use crate::{
    input::keys::HELP,
    mode::State,
    predictor::Predictor,
    render::{debug_view::DebugView, quality::Quality, tone::ToneCurve},
    window::settings::{GUARDS, LIGHTS_AT_A_TIME, MODES, Settings, Split},
};

pub(crate) struct Status<'a> {
    /// The server's tracing device; `None` offline.
    pub(crate) backend: Option<&'a str>,
    pub(crate) adapter: &'a str,
    pub(crate) server: &'a str,
    /// Start of the certificate's SHA-256.
    pub(crate) fingerprint: Option<&'a str>,
    pub(crate) picture_px: (u32, u32),
    pub(crate) speed_m_per_s: f64,
    /// True if a local reference can be shown.
    pub(crate) has_reference: bool,
    /// Why the scene cannot be edited. `None` if it can.
    pub(crate) not_editable: Option<&'a str>,
    /// About the server or a saved picture.
    pub(crate) notice: Option<&'a str>,
}

/// Draws the overlay, and changes `settings` as the person chooses.
pub(crate) fn show(context: &egui::Context, settings: &mut Settings, figures: &Figures, status: &Status<'_>) {
    if settings.overlay {
        let height = context.content_rect().height();
        egui::Area::new(egui::Id::unique("overlay")).anchor(Align2::LEFT_TOP, [8.0, 8.0]).show(context, |ui| {
            frame().show(ui, |ui| {
                ui.set_width(252.0);
                scrolled(ui, height, |ui| {
                    if let Some(now) = figures.now() {
                        rows(ui, &now, status);
                    }
                    graphs::show(ui, figures);
                    settings_rows(ui, settings, status.not_editable);
                });
            });
        });
    }
    if let Some(notice) = status.notice {
        egui::Area::new(egui::Id::unique("notice")).anchor(Align2::CENTER_BOTTOM, [0.0, -16.0]).show(context, |ui| {
            frame().show(ui, |ui| ui.label(RichText::new(notice).size(16.0).strong()));
        });
    }
    if settings.split != Split::Off {
        split_labels(context, settings.split, status.has_reference);
    }
    if settings.help {
        help(context);
    }
}

fn split_labels(context: &egui::Context, split: Split, has_reference: bool) {
    let middle = context.content_rect().center();
    let right = match split {
        Split::Reference if !has_reference => "the local reference is still starting".to_owned(),
        split => split.to_string(),
    };
    let painter = context.layer_painter(egui::LayerId::background());
    painter.vline(middle.x, context.content_rect().y_range(), egui::Stroke::new(2.0, TEXT));
    for (align, x, text) in [(Align2::RIGHT_TOP, -10.0, "with visibility"), (Align2::LEFT_TOP, 10.0, right.as_str())] {
        let at = egui::pos2(middle.x + x, 12.0);
        let font = egui::FontId::proportional(16.0);
        let galley = painter.layout_no_wrap(text.to_owned(), font, TEXT);
        let place = align.anchor_size(at, galley.size());
        painter.rect_filled(place.expand(5.0), 4.0, BACKGROUND);
        painter.galley(place.min, galley, TEXT);
    }
}

/// Adds contents that scroll if the window is too low.
fn scrolled(ui: &mut egui::Ui, window_height: f32, add: impl FnOnce(&mut egui::Ui)) {
    let height = (window_height - 40.0).max(60.0);
    egui::ScrollArea::vertical().max_height(height).min_scrolled_height(height).show(ui, add);
}

fn state_name(state: State) -> &'static str {
    match state {
        State::Sequential => "sequential",
        State::Concurrent => "concurrent",
        State::Degraded => "degraded",
    }
}

fn rows(ui: &mut egui::Ui, now: &Now, status: &Status<'_>) {
    let or_none = |value: Option<String>| value.unwrap_or_else(|| "–".to_owned());
    let ms = |value: Option<f64>| or_none(value.map(|ms| format!("{ms:.1} ms")));
    let lag = now.lag.map(|lag| if lag == 1 { "1 frame".to_owned() } else { format!("{lag} frames") });
    let rate = |per_s: f64| if per_s < 9.95 { format!("{per_s:.1} frames/s") } else { format!("{per_s:.0} frames/s") };
    let percent = |share: f64| format!("{:.1} %", share * 100.0);
    let (width, height) = status.picture_px;
    let mut rows = vec![
        ("picture", format!("{}, {width}×{height}", rate(now.client_fps))),
        ("speed", speed(status.speed_m_per_s)),
        ("client", status.adapter.to_owned()),
    ];
    if let Some(backend) = status.backend {
        rows.extend([
            ("visibility", rate(now.visibility_fps)),
            ("lag", format!("{}, response {}", or_none(lag), ms(now.response_ms))),
            ("round trip", ms(now.round_trip_ms)),
            ("loss", or_none(now.loss.map(percent))),
            ("bit rate", format!("{:.2} Mbit/s", now.megabits_per_s)),
            ("mode", format!("{}, {:.0} % received", state_name(now.state), now.visibility_share * 100.0)),
            ("known", or_none(now.known_share.map(percent))),
            // The device without its measured speed.
            ("server", format!("{}\n{}", status.server, backend.split(',').next().unwrap_or_default())),
        ]);
        if let Some(fingerprint) = status.fingerprint {
            rows.push(("certificate", format!("{fingerprint}…")));
        }
    } else {
        rows.push(("server", "none: no shadows".to_owned()));
    }
    for (name, value) in rows {
        ui.horizontal_top(|ui| {
            ui.spacing_mut().item_spacing.y = 1.0;
            ui.allocate_ui_with_layout([72.0, 14.0].into(), egui::Layout::top_down(egui::Align::Min), |ui| {
                ui.set_width(72.0);
                ui.label(RichText::new(name).color(BLUE));
            });
            ui.add(egui::Label::new(value).wrap());
        });
    }
}

/// In the unit that shows at least two digits.
fn speed(m_per_s: f64) -> String {
    match m_per_s {
        0.1.. => format!("{m_per_s:.2} m/s"),
        1e-4.. => format!("{:.2} mm/s", m_per_s * 1e3),
        _ => format!("{:.2} µm/s", m_per_s * 1e6),
    }
}

fn camera_row(ui: &mut egui::Ui, settings: &mut Settings) {
    if settings.cameras.is_empty() {
        return;
    }
    let Settings { cameras, camera, .. } = settings;
    // A file's names are a stranger's.
    let name = |index: usize| cameras.get(index).map(|camera| Escaped(&camera.name).to_string());
    ui.label(RichText::new("camera of the file (C)").color(BLUE));
    let chosen = camera.and_then(name).unwrap_or_else(|| "–".to_owned());
    egui::ComboBox::from_id_salt("camera").selected_text(chosen).show_ui(ui, |ui| {
        for index in 0..cameras.len() {
            ui.selectable_value(camera, Some(index), name(index).unwrap_or_default());
        }
    });
}

fn settings_rows(ui: &mut egui::Ui, settings: &mut Settings, not_editable: Option<&str>) {
    ui.separator();
    camera_row(ui, settings);
    choice_row(ui, "predictor (R)", &mut settings.predictor, &Predictor::ALL.map(|(_, predictor)| predictor));
    choice_row(ui, "quality", &mut settings.quality, &Quality::ALL);
    choice_row(ui, "mode (M)", &mut settings.mode, &MODES);
    choice_row(ui, "guard band (G)", &mut settings.guard, &GUARDS);
    let views: Vec<DebugView> = settings.views().collect();
    choice_row(ui, "view (V)", &mut settings.view, &views);
    choice_row(ui, "tone curve (T)", &mut settings.tone, &ToneCurve::ALL);
    let splits = settings.splits();
    choice_row(ui, "split (B)", &mut settings.split, splits);
    let (first, last) = settings.digits();
    let lights = match settings.lights {
        0..=LIGHTS_AT_A_TIME => "lights (1 to 9)".to_owned(),
        _ => format!("lights (1 to 9: {first} to {last}; 0: the next)"),
    };
    ui.label(RichText::new(lights).color(BLUE));
    ui.horizontal_wrapped(|ui| {
        for k in 0..settings.lights.min(32) {
            let mut on = settings.lights_on & (1 << k) != 0;
            if ui.toggle_value(&mut on, (k + 1).to_string()).changed() {
                settings.lights_on ^= 1 << k;
            }
        }
    });
    ui.horizontal_wrapped(|ui| {
        ui.checkbox(&mut settings.vsync, "vsync (X)");
        ui.checkbox(&mut settings.help, "help (H)");
        let edit = ui.add_enabled(not_editable.is_none(), egui::Checkbox::new(&mut settings.edit, "edit (I)"));
        edit.on_disabled_hover_text(not_editable.unwrap_or_default());
    });
    if let Some(why) = not_editable {
        ui.label(format!("edit: {why}"));
    }
}

fn choice_row<T: Copy + PartialEq + std::fmt::Display>(ui: &mut egui::Ui, name: &str, now: &mut T, all: &[T]) {
    ui.label(RichText::new(name).color(BLUE));
    ui.horizontal_wrapped(|ui| {
        for value in all {
            ui.selectable_value(now, *value, value.to_string());
        }
        // A value from the command line may be missing from the list.
        if !all.contains(now) {
            let _ = ui.selectable_label(true, now.to_string());
        }
    });
}

fn help(context: &egui::Context) {
    let height = context.content_rect().height();
    egui::Area::new(egui::Id::unique("help")).anchor(Align2::CENTER_CENTER, [0.0, 0.0]).show(context, |ui| {
        frame().show(ui, |ui| {
            scrolled(ui, height, |ui| {
                ui.label(RichText::new("Keys").size(18.0).strong());
                egui::Grid::new("keys").num_columns(2).spacing([18.0, 4.0]).show(ui, |ui| {
                    for (keys, meaning) in HELP {
                        ui.label(RichText::new(keys).color(ORANGE).strong());
                        ui.label(meaning);
                        ui.end_row();
                    }
                });
                ui.label("Gamepad: sticks move and look, triggers go up and down.");
            });
        });
    });
}

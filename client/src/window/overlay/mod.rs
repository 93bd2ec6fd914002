//! What stands over the picture: figures, graphs, choices, help, and what the server says.
//!
//! Everything here is also a key ([`crate::input::keys::HELP`]). Colours are those of Okabe and Ito (2008), which colour-blind people
//! tell apart, and nothing is told by colour alone.

pub(crate) mod figures;
mod graphs;
mod screens;

use egui::{Align2, Color32, RichText};

use self::figures::{Figures, Now};
use crate::{
    input::keys::HELP,
    mode::State,
    predictor::Predictor,
    render::debug_view::DebugView,
    settings::{GUARDS, LIGHTS_AT_A_TIME, MODES, Settings, Split},
};

pub(crate) use screens::{failure, loading};

pub(crate) const BLUE: Color32 = Color32::from_rgb(86, 180, 233);
pub(crate) const GREEN: Color32 = Color32::from_rgb(0, 158, 115);
pub(crate) const ORANGE: Color32 = Color32::from_rgb(230, 159, 0);
pub(crate) const TEXT: Color32 = Color32::from_rgb(235, 235, 235);

const PANEL: Color32 = Color32::from_rgba_premultiplied(12, 14, 18, 215);

/// What is known beside the figures.
pub(crate) struct About<'a> {
    /// What the server traces on; none offline.
    pub(crate) backend: Option<&'a str>,
    pub(crate) adapter: &'a str,
    pub(crate) server: &'a str,
    /// First digits of the server's certificate.
    pub(crate) fingerprint: Option<&'a str>,
    pub(crate) picture_px: (u32, u32),
    pub(crate) speed_m_per_s: f64,
    /// Whether a local reference is there to be shown.
    pub(crate) has_reference: bool,
    /// Something that the person should know: about the server, or a picture that was kept.
    pub(crate) notice: Option<&'a str>,
}

/// How the overlay looks, once for all frames.
pub(crate) fn style(context: &egui::Context) {
    context.set_theme(egui::Theme::Dark);
    context.all_styles_mut(|style| {
        style.visuals.override_text_color = Some(TEXT);
        style.visuals.selection.bg_fill = Color32::from_rgb(0, 90, 140);
        style.interaction.selectable_labels = true;
        style.animation_time = 0.0;
    });
}

pub(crate) fn frame() -> egui::Frame {
    egui::Frame::new().fill(PANEL).inner_margin(10).corner_radius(6)
}

/// Draws it, and takes the person's choices.
pub(crate) fn show(context: &egui::Context, settings: &mut Settings, figures: &Figures, about: &About<'_>) {
    if settings.overlay {
        let height = context.content_rect().height();
        egui::Area::new(egui::Id::unique("overlay")).anchor(Align2::LEFT_TOP, [8.0, 8.0]).show(context, |ui| {
            frame().show(ui, |ui| {
                ui.set_width(252.0);
                scrolled(ui, height, |ui| {
                    if let Some(now) = figures.now() {
                        rows(ui, &now, about);
                    }
                    graphs::show(ui, figures);
                    choices(ui, settings);
                });
            });
        });
    }
    if let Some(notice) = about.notice {
        egui::Area::new(egui::Id::unique("notice")).anchor(Align2::CENTER_BOTTOM, [0.0, -16.0]).show(context, |ui| {
            frame().show(ui, |ui| ui.label(RichText::new(notice).size(16.0).strong()));
        });
    }
    if settings.split != Split::Off {
        let middle = context.content_rect().center();
        let right = match settings.split {
            Split::Reference if !about.has_reference => "the local reference is not there yet".to_owned(),
            split => split.to_string(),
        };
        let painter = context.layer_painter(egui::LayerId::background());
        painter.vline(middle.x, context.content_rect().y_range(), egui::Stroke::new(2.0, TEXT));
        for (align, x, text) in
            [(Align2::RIGHT_TOP, -10.0, "with visibility"), (Align2::LEFT_TOP, 10.0, right.as_str())]
        {
            let at = egui::pos2(middle.x + x, 12.0);
            let font = egui::FontId::proportional(16.0);
            let galley = painter.layout_no_wrap(text.to_owned(), font, TEXT);
            let place = align.anchor_size(at, galley.size());
            painter.rect_filled(place.expand(5.0), 4.0, PANEL);
            painter.galley(place.min, galley, TEXT);
        }
    }
    if settings.help {
        help(context);
    }
}

/// As high as it takes, unless the window is lower.
fn scrolled(ui: &mut egui::Ui, window: f32, add: impl FnOnce(&mut egui::Ui)) {
    let most = (window - 40.0).max(60.0);
    egui::ScrollArea::vertical().max_height(most).min_scrolled_height(most).show(ui, add);
}

fn state_name(state: State) -> &'static str {
    match state {
        State::Sequential => "sequential",
        State::Concurrent => "concurrent",
        State::Degraded => "degraded",
    }
}

fn rows(ui: &mut egui::Ui, now: &Now, about: &About<'_>) {
    let or_none = |value: Option<String>| value.unwrap_or_else(|| "–".to_owned());
    let ms = |value: Option<f64>| or_none(value.map(|ms| format!("{ms:.1} ms")));
    let lag = now.lag.map(|lag| if lag == 1 { "1 frame".to_owned() } else { format!("{lag} frames") });
    let rate = |per_s: f64| if per_s < 9.95 { format!("{per_s:.1} frames/s") } else { format!("{per_s:.0} frames/s") };
    let percent = |share: f64| format!("{:.1} %", share * 100.0);
    let (width, height) = about.picture_px;
    let mut rows = vec![
        ("picture", format!("{}, {width}×{height}", rate(now.client_fps))),
        ("speed", format!("{:.2} m/s", about.speed_m_per_s)),
        ("client", about.adapter.to_owned()),
    ];
    if let Some(backend) = about.backend {
        rows.extend([
            ("visibility", rate(now.visibility_fps)),
            ("lag", format!("{}, response {}", or_none(lag), ms(now.response_ms))),
            ("round trip", ms(now.round_trip_ms)),
            ("loss", or_none(now.loss.map(percent))),
            ("bit rate", format!("{:.2} Mbit/s", now.megabits_per_s)),
            ("mode", format!("{}, {:.0} % received", state_name(now.state), now.visibility_share * 100.0)),
            ("known", or_none(now.known_share.map(percent))),
            // What it is, without its figures.
            ("server", format!("{}\n{}", about.server, backend.split(',').next().unwrap_or_default())),
        ]);
        if let Some(fingerprint) = about.fingerprint {
            rows.push(("certificate", format!("{fingerprint}…")));
        }
    } else {
        rows.push(("server", "none: every light reaches everything".to_owned()));
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

fn choices(ui: &mut egui::Ui, settings: &mut Settings) {
    ui.separator();
    choice(ui, "predictor (R)", &mut settings.predictor, &Predictor::ALL.map(|(_, predictor)| predictor));
    choice(ui, "mode (M)", &mut settings.mode, &MODES);
    choice(ui, "guard band (G)", &mut settings.guard, &GUARDS);
    let views: Vec<DebugView> = settings.views().collect();
    choice(ui, "view (V)", &mut settings.view, &views);
    let splits = settings.splits();
    choice(ui, "split (B)", &mut settings.split, splits);
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
    });
}

fn choice<T: Copy + PartialEq + std::fmt::Display>(ui: &mut egui::Ui, name: &str, now: &mut T, all: &[T]) {
    ui.label(RichText::new(name).color(BLUE));
    ui.horizontal_wrapped(|ui| {
        for one in all {
            ui.selectable_value(now, *one, one.to_string());
        }
        // One that came from the command line.
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
                ui.label("Gamepad: sticks walk and look, triggers climb.");
            });
        });
    });
}

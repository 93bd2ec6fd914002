use egui::Color32;

pub(super) const BLUE: Color32 = Color32::from_rgb(86, 180, 233);
pub(super) const GREEN: Color32 = Color32::from_rgb(0, 158, 115);
pub(super) const ORANGE: Color32 = Color32::from_rgb(230, 159, 0);
pub(super) const VERMILLION: Color32 = Color32::from_rgb(213, 94, 0);
pub(super) const TEXT: Color32 = Color32::from_rgb(235, 235, 235);
pub(super) const BACKGROUND: Color32 = Color32::from_rgba_premultiplied(12, 14, 18, 215);

/// Sets the style of all frames.
pub(in crate::window) fn set_style(context: &egui::Context) {
    context.set_theme(egui::Theme::Dark);
    context.all_styles_mut(|style| {
        style.visuals.override_text_color = Some(TEXT);
        style.visuals.selection.bg_fill = Color32::from_rgb(0, 90, 140);
        style.interaction.selectable_labels = true;
        style.animation_time = 0.0;
    });
}

pub(super) fn frame() -> egui::Frame {
    egui::Frame::new().fill(BACKGROUND).inner_margin(10).corner_radius(6)
}

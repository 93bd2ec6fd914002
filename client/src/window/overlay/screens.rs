//! Screens without a picture: loading and failure.

use egui::{Align2, RichText};

use super::style::{BLUE, frame};

/// Shows the progress of loading; `share` is the part of the scene that has arrived.
pub(crate) fn loading(
    context: &egui::Context,
    server: &str,
    fingerprint: Option<&str>,
    text: &str,
    share: Option<f32>,
) {
    egui::Area::new(egui::Id::unique("loading")).anchor(Align2::CENTER_CENTER, [0.0, 0.0]).show(context, |ui| {
        frame().show(ui, |ui| {
            ui.set_width(420.0);
            ui.label(RichText::new("Gnomon").size(26.0).strong());
            ui.label(RichText::new(server).color(BLUE).size(16.0));
            if let Some(fingerprint) = fingerprint {
                ui.label(format!("certificate {fingerprint}…"));
            }
            ui.add_space(8.0);
            if let Some(share) = share {
                ui.add(egui::ProgressBar::new(share).desired_width(400.0).show_percentage());
            }
            ui.label(RichText::new(text).size(15.0));
        });
    });
}

/// Asks whether to trust a server that is visited for the first time. Returns the answer, once there is one. Enter is
/// none: the program that started this one may still hold it.
pub(crate) fn first_visit(context: &egui::Context, server: &str, sha256: &str) -> Option<bool> {
    let mut answer = None;
    egui::Area::new(egui::Id::unique("first visit")).anchor(Align2::CENTER_CENTER, [0.0, 0.0]).show(context, |ui| {
        frame().show(ui, |ui| {
            ui.set_width(460.0);
            ui.label(RichText::new("First visit").size(22.0).strong());
            ui.label(RichText::new(server).color(BLUE).size(16.0));
            ui.label("It shows a certificate with this SHA-256:");
            ui.add(egui::Label::new(RichText::new(sha256).monospace()).wrap());
            ui.label("Is it the one in the line that the server printed? Your token goes to whoever holds its key.");
            ui.add_space(8.0);
            ui.horizontal(|ui| {
                if ui.button(RichText::new("yes, connect (Y)").size(15.0)).clicked() {
                    answer = Some(true);
                }
                if ui.button(RichText::new("no (N)").size(15.0)).clicked() {
                    answer = Some(false);
                }
            });
        });
    });
    let pressed = |key| context.input(|input| input.key_pressed(key));
    answer.or_else(|| pressed(egui::Key::Y).then_some(true)).or_else(|| pressed(egui::Key::N).then_some(false))
}

/// Shows why there is no picture. Returns whether to try again.
pub(crate) fn failure(context: &egui::Context, reason: &str) -> bool {
    let mut retry = false;
    egui::Area::new(egui::Id::unique("failure")).anchor(Align2::CENTER_CENTER, [0.0, 0.0]).show(context, |ui| {
        frame().show(ui, |ui| {
            ui.set_width(460.0);
            ui.label(RichText::new("No picture").size(22.0).strong());
            ui.add(egui::Label::new(RichText::new(reason).size(15.0)).wrap());
            ui.add_space(8.0);
            ui.horizontal(|ui| {
                retry = ui.button(RichText::new("try again (Enter)").size(15.0)).clicked();
                ui.label("or leave with Esc");
            });
        });
    });
    retry || context.input(|input| input.key_pressed(egui::Key::Enter))
}

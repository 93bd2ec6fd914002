//! Passes window events to the overlay, the controls and the screen.

use winit::{
    event::{ElementState, MouseButton, MouseScrollDelta, TouchPhase, WindowEvent},
    keyboard::{Key, NamedKey, PhysicalKey},
};

use super::{
    app::{App, View},
    editing::Editing,
    keys::{command, move_key},
};

/// Commands that may wait for the next frame.
const MAX_COMMANDS: usize = 64;

/// Touchpad pixels that count as one notch of a wheel.
const PX_PER_NOTCH: f64 = 60.0;

impl App {
    pub(super) fn handle_event(&mut self, event: &WindowEvent) {
        if let WindowEvent::DroppedFile(file) = event {
            return self.open_file(file);
        }
        let Some(View { window, screen, egui }) = &mut self.view else { return };
        // Tab would cycle through the overlay's widgets, but each of them has its own key.
        let tab = matches!(event, WindowEvent::KeyboardInput { event, .. }
            if event.logical_key == Key::Named(NamedKey::Tab));
        let consumed = !tab && egui.on_window_event(window, event).consumed;
        // A number is being typed: its keys mean nothing else.
        let (types, control) = (egui.egui_ctx().text_edit_focused(), self.control);
        let controls = &mut self.controls;
        match event {
            WindowEvent::Resized(size) => {
                screen.resize((size.width, size.height));
                self.hidden = size.width == 0 || size.height == 0;
            }
            WindowEvent::Occluded(occluded) => self.hidden = *occluded,
            WindowEvent::Focused(false) => {
                controls.let_go();
                self.control = false;
                self.editing().into_iter().for_each(Editing::let_go);
            }
            WindowEvent::ModifiersChanged(now) => self.control = now.state().control_key() || now.state().super_key(),
            WindowEvent::KeyboardInput { event, .. } => {
                let down = event.state == ElementState::Pressed;
                let moves = match event.physical_key {
                    PhysicalKey::Code(code) => move_key(code),
                    PhysicalKey::Unidentified(_) => None,
                };
                if let Some(key) = moves {
                    controls.held.set(key, down && !types && !control);
                }
                // With Ctrl the label counts, wherever the key is.
                if (moves.is_none() || control)
                    && down
                    && !types
                    && !event.repeat
                    && self.commands.len() < MAX_COMMANDS
                    && let Some(command) = command(&event.logical_key, control)
                {
                    self.commands.push(command);
                }
            }
            WindowEvent::CursorMoved { position, .. } => {
                controls.pointer_at(position.x, position.y);
                self.pointer_at(position.x, position.y);
            }
            WindowEvent::MouseInput { state: ElementState::Pressed, button: MouseButton::Left, .. } if !consumed => {
                let context = egui.egui_ctx().clone();
                // The overlay learns only with the next picture where the pointer is now.
                let covered = |place: egui::Pos2| {
                    context.layer_id_at(place).is_some_and(|layer| layer.order != egui::Order::Background)
                };
                // What drags a handle does not turn the view.
                let holds = self.editing().is_some_and(|editing| editing.press(covered));
                self.controls.drag(!holds);
            }
            WindowEvent::MouseInput { state: ElementState::Released, button: MouseButton::Left, .. } => {
                controls.drag(false);
                self.editing().into_iter().for_each(Editing::release);
            }
            WindowEvent::MouseInput { state, button: MouseButton::Left | MouseButton::Right, .. } => {
                controls.drag(*state == ElementState::Pressed && !consumed);
            }
            WindowEvent::MouseWheel { delta, .. } if !consumed => controls.wheel(match delta {
                MouseScrollDelta::LineDelta(_, lines) => f64::from(*lines),
                MouseScrollDelta::PixelDelta(position) => position.y / PX_PER_NOTCH,
            }),
            WindowEvent::Touch(touch) => {
                let (x, y) = (touch.location.x, touch.location.y);
                match touch.phase {
                    TouchPhase::Started if !consumed => controls.touches.begin(touch.id, x, y),
                    TouchPhase::Started => {}
                    TouchPhase::Moved => controls.touches.go(touch.id, x, y),
                    TouchPhase::Ended | TouchPhase::Cancelled => controls.touches.end(touch.id),
                }
            }
            _ => {}
        }
    }
}

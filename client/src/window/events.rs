//! Passes window events to the overlay, the controls and the screen.

use winit::{
    event::{ElementState, MouseButton, MouseScrollDelta, TouchPhase, WindowEvent},
    keyboard::{Key, NamedKey, PhysicalKey},
};

use super::{
    app::{App, View},
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
        let controls = &mut self.controls;
        match event {
            WindowEvent::Resized(size) => {
                screen.resize((size.width, size.height));
                self.hidden = size.width == 0 || size.height == 0;
            }
            WindowEvent::Occluded(occluded) => self.hidden = *occluded,
            WindowEvent::Focused(false) => controls.let_go(),
            WindowEvent::KeyboardInput { event, .. } => {
                let down = event.state == ElementState::Pressed;
                if let PhysicalKey::Code(code) = event.physical_key
                    && let Some(key) = move_key(code)
                {
                    controls.held.set(key, down);
                } else if down
                    && !event.repeat
                    && self.commands.len() < MAX_COMMANDS
                    && let Some(command) = command(&event.logical_key)
                {
                    self.commands.push(command);
                }
            }
            WindowEvent::CursorMoved { position, .. } => controls.pointer_at(position.x, position.y),
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

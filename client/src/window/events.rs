//! The system's events, told to those whom they concern: the overlay, the controls, the screen.

use winit::{
    event::{ElementState, MouseButton, MouseScrollDelta, TouchPhase, WindowEvent},
    keyboard::{Key, NamedKey, PhysicalKey},
};

use super::keys::{command, move_key};
use super::{App, Opened};

/// Most commands that wait for the next frame.
const MOST_COMMANDS: usize = 64;

/// Pixels of a touchpad that count as a notch of a wheel.
const PX_PER_NOTCH: f64 = 60.0;

impl App {
    /// Takes an event's part in everything.
    pub(super) fn note(&mut self, event: &WindowEvent) {
        let Some(Opened { window, screen, egui }) = &mut self.opened else { return };
        // Tab would go through the overlay's choices, each of which has a key of its own.
        let tab = matches!(event, WindowEvent::KeyboardInput { event, .. }
            if event.logical_key == Key::Named(NamedKey::Tab));
        let overlay_has_it = !tab && egui.on_window_event(window, event).consumed;
        let controls = &mut self.controls;
        match event {
            WindowEvent::Resized(size) => {
                screen.resize((size.width, size.height));
                self.unseen = size.width == 0 || size.height == 0;
            }
            WindowEvent::Occluded(occluded) => self.unseen = *occluded,
            WindowEvent::Focused(false) => controls.let_go(),
            WindowEvent::KeyboardInput { event, .. } => {
                let down = event.state == ElementState::Pressed;
                if let PhysicalKey::Code(code) = event.physical_key
                    && let Some(key) = move_key(code)
                {
                    controls.held.set(key, down);
                } else if down
                    && !event.repeat
                    && self.commands.len() < MOST_COMMANDS
                    && let Some(command) = command(&event.logical_key)
                {
                    self.commands.push(command);
                }
            }
            WindowEvent::CursorMoved { position, .. } => controls.pointer_at(position.x, position.y),
            WindowEvent::MouseInput { state, button: MouseButton::Left | MouseButton::Right, .. } => {
                controls.drag(*state == ElementState::Pressed && !overlay_has_it);
            }
            WindowEvent::MouseWheel { delta, .. } if !overlay_has_it => controls.wheel(match delta {
                MouseScrollDelta::LineDelta(_, lines) => f64::from(*lines),
                MouseScrollDelta::PixelDelta(position) => position.y / PX_PER_NOTCH,
            }),
            WindowEvent::Touch(touch) => {
                let (x, y) = (touch.location.x, touch.location.y);
                match touch.phase {
                    TouchPhase::Started if !overlay_has_it => controls.touches.begin(touch.id, x, y),
                    TouchPhase::Started => {}
                    TouchPhase::Moved => controls.touches.go(touch.id, x, y),
                    TouchPhase::Ended | TouchPhase::Cancelled => controls.touches.end(touch.id),
                }
            }
            _ => {}
        }
    }
}

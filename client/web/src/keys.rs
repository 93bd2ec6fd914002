//! Keys by their place on the keyboard, as pages name them.

use gnomon_client_core::input::keys::MoveKey;

/// `None` if the key moves nothing.
#[must_use]
pub fn move_key(code: &str) -> Option<MoveKey> {
    Some(match code {
        "KeyW" | "ArrowUp" => MoveKey::Forward,
        "KeyS" | "ArrowDown" => MoveKey::Back,
        "KeyA" | "ArrowLeft" => MoveKey::Left,
        "KeyD" | "ArrowRight" => MoveKey::Right,
        "KeyE" | "PageUp" => MoveKey::Up,
        "KeyQ" | "PageDown" => MoveKey::Down,
        "ShiftLeft" | "ShiftRight" => MoveKey::Fast,
        _ => return None,
    })
}

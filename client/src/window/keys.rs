//! Key bindings. Movement keys go by their position on the keyboard, commands by their label.

use gnomon_client_core::input::keys::{Command, MoveKey};
use winit::keyboard::{Key, KeyCode, NamedKey};

/// Returns the direction of a key, if it has one.
#[must_use]
pub(super) fn move_key(code: KeyCode) -> Option<MoveKey> {
    Some(match code {
        KeyCode::KeyW | KeyCode::ArrowUp => MoveKey::Forward,
        KeyCode::KeyS | KeyCode::ArrowDown => MoveKey::Back,
        KeyCode::KeyA | KeyCode::ArrowLeft => MoveKey::Left,
        KeyCode::KeyD | KeyCode::ArrowRight => MoveKey::Right,
        KeyCode::KeyE | KeyCode::PageUp => MoveKey::Up,
        KeyCode::KeyQ | KeyCode::PageDown => MoveKey::Down,
        KeyCode::ShiftLeft | KeyCode::ShiftRight => MoveKey::Fast,
        _ => return None,
    })
}

/// Returns the command of a key, if it has one. `control`: the key is pressed together with Ctrl.
#[must_use]
pub(super) fn command(key: &Key, control: bool) -> Option<Command> {
    match key {
        Key::Character(text) if control => match text.as_str() {
            "z" => Some(Command::Undo),
            "Z" | "y" => Some(Command::Redo),
            _ => None,
        },
        Key::Named(NamedKey::Tab) => Some(Command::Path),
        Key::Named(NamedKey::Escape) => Some(Command::Leave),
        Key::Named(NamedKey::F11) => Some(Command::FullScreen),
        Key::Named(NamedKey::F1) => Some(Command::Help),
        Key::Character(text) => Some(match text.to_lowercase().as_str() {
            "c" => Command::Camera,
            "f" => Command::FullScreen,
            "p" => Command::Picture,
            "h" | "?" => Command::Help,
            "o" => Command::Overlay,
            "i" => Command::Edit,
            "r" => Command::Predictor,
            "m" => Command::Mode,
            "g" => Command::Guard,
            "v" => Command::View,
            "b" => Command::Split,
            "t" => Command::Tone,
            "x" => Command::Vsync,
            "0" => Command::NextLights,
            digit => Command::Digit(digit.parse::<u32>().ok().filter(|digit| (1..=9).contains(digit))? - 1),
        }),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn commands_ignore_case() {
        let of = |text: &str| command(&Key::Character(text.into()), false);
        assert_eq!(
            (of("f"), of("P"), of("H")),
            (Some(Command::FullScreen), Some(Command::Picture), Some(Command::Help))
        );
        assert_eq!(
            (of("1"), of("9"), of("0"), of("w")),
            (Some(Command::Digit(0)), Some(Command::Digit(8)), Some(Command::NextLights), None)
        );
        assert_eq!(command(&Key::Named(NamedKey::Tab), false), Some(Command::Path));
        assert_eq!(command(&Key::Named(NamedKey::Escape), false), Some(Command::Leave));
    }

    #[test]
    fn keys_with_control_are_others() {
        let of = |text: &str| command(&Key::Character(text.into()), true);
        assert_eq!((of("z"), of("Z"), of("y")), (Some(Command::Undo), Some(Command::Redo), Some(Command::Redo)));
        assert_eq!((of("c"), of("v"), of("1")), (None, None, None));
    }

    #[test]
    fn arrows_move_like_letters() {
        for (letter, arrow) in [
            (KeyCode::KeyW, KeyCode::ArrowUp),
            (KeyCode::KeyA, KeyCode::ArrowLeft),
            (KeyCode::KeyS, KeyCode::ArrowDown),
            (KeyCode::KeyD, KeyCode::ArrowRight),
        ] {
            assert!(move_key(letter).is_some() && move_key(letter) == move_key(arrow));
        }
        assert_eq!(move_key(KeyCode::KeyF), None);
    }
}

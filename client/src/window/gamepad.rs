use gilrs::{Axis, Button, EventType, Gilrs};

use crate::input::{Sticks, keys::Command};

/// The machine's gamepads. Does nothing if there are none or the system denies access.
pub(crate) struct Gamepad {
    gilrs: Option<Gilrs>,
}

impl Gamepad {
    pub(crate) fn open() -> Self {
        let gilrs = Gilrs::new().inspect_err(|error| tracing::debug!(%error, "no gamepads")).ok();
        Self { gilrs }
    }

    /// Reads the sticks, and passes on the commands since the last call.
    pub(crate) fn poll(&mut self, sticks: &mut Sticks, mut command: impl FnMut(Command)) {
        let Some(gilrs) = &mut self.gilrs else { return };
        let mut changed = false;
        while let Some(event) = gilrs.next_event() {
            changed = true;
            match event.event {
                EventType::ButtonPressed(Button::Start, _) => command(Command::Help),
                EventType::ButtonPressed(Button::Select, _) => command(Command::Overlay),
                EventType::ButtonPressed(Button::North, _) => command(Command::View),
                EventType::ButtonPressed(Button::West, _) => command(Command::Picture),
                EventType::ButtonPressed(Button::South, _) => command(Command::Path),
                EventType::ButtonPressed(Button::East, _) => command(Command::Split),
                EventType::Connected => tracing::info!(name = gilrs.gamepad(event.id).name(), "gamepad"),
                _ => {}
            }
        }
        if !changed {
            return;
        }
        // The first gamepad with moved sticks counts.
        *sticks =
            gilrs.gamepads().map(|(_, pad)| read(&pad)).find(|read| *read != Sticks::default()).unwrap_or_default();
    }
}

fn read(pad: &gilrs::Gamepad<'_>) -> Sticks {
    let axis = |axis| f64::from(pad.value(axis));
    let trigger = |button| pad.button_data(button).map_or(0.0, |data| f64::from(data.value()));
    Sticks {
        walk: (axis(Axis::LeftStickX), axis(Axis::LeftStickY)),
        look: (axis(Axis::RightStickX), axis(Axis::RightStickY)),
        climb: trigger(Button::RightTrigger2) - trigger(Button::LeftTrigger2),
    }
}

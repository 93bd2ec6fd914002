//! What a key can ask for: a direction while it is held, or a command once.

/// A direction, for as long as its key is held.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MoveKey {
    /// Along the view.
    Forward,
    /// Against it.
    Back,
    /// To the left.
    Left,
    /// To the right.
    Right,
    /// Up in the world.
    Up,
    /// Down in the world.
    Down,
    /// Any way, faster.
    Fast,
}

/// Something that a key does once.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Command {
    /// The camera path instead of the person, or the person again.
    Path,
    /// The whole screen, or a window again.
    FullScreen,
    /// Keep a picture.
    Picture,
    /// What the keys do.
    Help,
    /// Figures and choices.
    Overlay,
    /// The next way to predict.
    Predictor,
    /// The next mode.
    Mode,
    /// The next guard band.
    Guard,
    /// The next debug view.
    View,
    /// The next thing for the right half of the picture.
    Split,
    /// Wait for the screen or not.
    Vsync,
    /// The light that this digit means, counted from 0, on or off.
    Digit(u32),
    /// Digits mean the next lights.
    NextLights,
    /// The end.
    Leave,
}

/// Every command's key and what it does, for whoever asks.
pub const HELP: [(&str, &str); 16] = [
    ("W A S D, arrows", "walk"),
    ("Q E", "down and up"),
    ("Shift", "faster while held"),
    ("drag", "look; with two fingers walk"),
    ("wheel", "speed"),
    ("Tab", "camera path"),
    ("F", "full screen"),
    ("P", "picture to a PNG file"),
    ("O", "figures and choices"),
    ("V", "next debug view"),
    ("B", "right half: without visibility, or a local reference"),
    ("1 to 9", "each light on and off"),
    ("0", "1 to 9 mean the next nine lights"),
    ("R M G", "predictor, mode, guard band"),
    ("X", "wait for the screen (vsync)"),
    ("H, Esc", "this help, leave"),
];

/// Keys that are down, a bit each.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Held(u8);

impl Held {
    /// Notes a key's press or release.
    pub fn set(&mut self, key: MoveKey, down: bool) {
        let bit = 1 << key as u8;
        self.0 = if down { self.0 | bit } else { self.0 & !bit };
    }

    fn has(self, key: MoveKey) -> bool {
        self.0 & (1 << key as u8) != 0
    }

    fn between(self, positive: MoveKey, negative: MoveKey) -> f64 {
        f64::from(i8::from(self.has(positive)) - i8::from(self.has(negative)))
    }

    pub(crate) fn forward(self) -> f64 {
        self.between(MoveKey::Forward, MoveKey::Back)
    }

    pub(crate) fn right(self) -> f64 {
        self.between(MoveKey::Right, MoveKey::Left)
    }

    pub(crate) fn up(self) -> f64 {
        self.between(MoveKey::Up, MoveKey::Down)
    }

    pub(crate) fn fast(self) -> bool {
        self.has(MoveKey::Fast)
    }
}

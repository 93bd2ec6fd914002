//! Keys: a direction while held, or a command when pressed.

/// A direction, while its key is held.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MoveKey {
    /// Along the view.
    Forward,
    Back,
    Left,
    Right,
    /// Up in the world.
    Up,
    /// Down in the world.
    Down,
    /// Faster, in any direction.
    Fast,
}

/// What a key does when pressed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Command {
    /// Switches between the camera path and manual control.
    Path,
    /// Goes to the next camera of the scene's file.
    Camera,
    /// Switches between full screen and window.
    FullScreen,
    /// Saves a picture.
    Picture,
    /// Shows the keys.
    Help,
    /// Shows figures and settings.
    Overlay,
    /// Begins or ends editing the scene.
    Edit,
    /// Takes the last edit back.
    Undo,
    /// Does again what was undone last.
    Redo,
    /// Next predictor.
    Predictor,
    Mode,
    Guard,
    /// Next debug view.
    View,
    /// Next tone curve.
    Tone,
    /// Next content of the picture's right half.
    Split,
    /// Turns vsync on or off.
    Vsync,
    /// Turns on or off the light of this digit, counted from 0.
    Digit(u32),
    /// Assigns the digits to the next lights.
    NextLights,
    Leave,
}

/// Every key and what it does.
pub const HELP: [(&str, &str); 19] = [
    ("W A S D, arrows", "walk"),
    ("Q E", "down and up"),
    ("Shift", "faster while held"),
    ("drag", "look; with two fingers walk"),
    ("wheel", "speed"),
    ("Tab", "camera path"),
    ("C", "next camera of the file"),
    ("F", "full screen"),
    ("P", "picture to a PNG file"),
    ("O", "figures and choices"),
    ("I", "edit: click an object or a lamp, drag its handles"),
    ("Ctrl+Z, Ctrl+Y", "undo and redo an edit"),
    ("V", "next debug view"),
    ("B", "right half: without visibility, or a local reference"),
    ("1 to 9", "each light on and off"),
    ("0", "1 to 9 mean the next nine lights"),
    ("R M G T", "predictor, mode, guard band, tone curve"),
    ("X", "wait for the screen (vsync)"),
    ("H, Esc", "this help, leave"),
];

/// Keys that are held, one bit each.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Held(u8);

impl Held {
    /// Records a key's press or release.
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

//! Settings that a person can change while the window is open.

use std::{fmt, sync::Arc};

use gnomon_client_core::camera::of_scene;
use gnomon_protocol::limits::MAX_LAYERS;
use gnomon_scene::NamedCamera;

use crate::{
    guard::{Guard, GuardSize},
    input::keys::Command,
    mode::Mode,
    predictor::Predictor,
    render::{debug_view::DebugView, quality::Quality, tone::ToneCurve},
};

/// Content of the picture's right half.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) enum Split {
    /// The same as in the left half.
    #[default]
    Off,
    /// Every light reaches everything.
    Unlit,
    /// Visibility traced by a server on this machine for exactly this picture.
    Reference,
}

impl fmt::Display for Split {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Off => "off",
            Self::Unlit => "without visibility",
            Self::Reference => "local reference",
        })
    }
}

/// Lights that the digits 1 to 9 switch at a time.
pub(crate) const LIGHTS_AT_A_TIME: u32 = 9;

#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Settings {
    pub(crate) predictor: Predictor,
    pub(crate) quality: Quality,
    pub(crate) mode: Mode,
    pub(crate) guard: Guard,
    pub(crate) view: DebugView,
    pub(crate) split: Split,
    pub(crate) tone: ToneCurve,
    /// True if a server program beside this one can trace a reference.
    pub(crate) reference: bool,
    /// Cameras of the scene's file, each with a name or number.
    pub(crate) cameras: Arc<[NamedCamera]>,
    /// The one that was visited last.
    pub(crate) camera: Option<usize>,
    pub(crate) lights: u32,
    /// One bit for each light.
    pub(crate) lights_on: u32,
    /// The light of the digit 1, counted from 0.
    pub(crate) first_digit: u32,
    pub(crate) vsync: bool,
    /// True if figures and settings are shown.
    pub(crate) overlay: bool,
    /// True if the keys are explained.
    pub(crate) help: bool,
    /// True if the person edits the scene.
    pub(crate) edit: bool,
}

/// The guard bands that a key cycles through.
pub(crate) const GUARDS: [Guard; 4] = [
    Guard::Fixed(GuardSize { width: 0, height: 0 }),
    Guard::Fixed(GuardSize { width: 64, height: 36 }),
    Guard::Fixed(GuardSize { width: 128, height: 72 }),
    Guard::Auto,
];

/// The modes that a key cycles through.
pub(crate) const MODES: [Mode; 3] = [Mode::Auto, Mode::Concurrent, Mode::Sequential];

fn after<T: Copy + PartialEq>(all: &[T], now: T) -> T {
    let place = all.iter().position(|one| *one == now).map_or(0, |place| (place + 1) % all.len().max(1));
    all.get(place).copied().unwrap_or(now)
}

impl Settings {
    /// Returns all debug views, in the order in which a key cycles through them.
    pub(crate) fn views(&self) -> impl Iterator<Item = DebugView> {
        let lights = (0..self.lights).map(DebugView::Light);
        [
            DebugView::Picture,
            DebugView::Unknown,
            DebugView::Age { lags: [0; MAX_LAYERS] },
            DebugView::Depth,
            DebugView::Normals,
        ]
        .into_iter()
        .chain(lights)
    }

    /// Returns the possible contents of the right half.
    #[must_use]
    pub(crate) const fn splits(&self) -> &'static [Split] {
        const SPLITS: [Split; 3] = [Split::Off, Split::Unlit, Split::Reference];
        if self.reference { &SPLITS } else { SPLITS.split_at(2).0 }
    }

    /// Returns the first and last light of the digits, counted from 1.
    #[must_use]
    pub(crate) fn digits(&self) -> (u32, u32) {
        (self.first_digit + 1, (self.first_digit + LIGHTS_AT_A_TIME).min(self.lights).max(1))
    }

    /// Takes a new scene's cameras. The first picture is not from one of them if a path was asked for, so none is
    /// visited yet.
    pub(crate) fn set_cameras(&mut self, cameras: &[NamedCamera]) {
        let labelled = |(index, camera)| NamedCamera { name: of_scene::label(index, camera), ..camera.clone() };
        self.cameras = cameras.iter().enumerate().map(labelled).collect();
        self.camera = None;
    }

    /// Applies a key's command, if it changes a setting.
    pub(crate) fn apply(&mut self, command: Command) {
        match command {
            Command::Help => self.help = !self.help,
            Command::Edit => self.edit = !self.edit,
            Command::Overlay => self.overlay = !self.overlay,
            Command::Predictor => {
                let all = Predictor::ALL.map(|(_, predictor)| predictor);
                self.predictor = after(&all, self.predictor);
            }
            Command::Mode => self.mode = after(&MODES, self.mode),
            Command::Guard => self.guard = after(&GUARDS, self.guard),
            Command::View => {
                let all: Vec<_> = self.views().collect();
                self.view = after(&all, self.view);
            }
            Command::Tone => self.tone = after(&ToneCurve::ALL, self.tone),
            Command::Split => self.split = after(self.splits(), self.split),
            Command::Camera if !self.cameras.is_empty() => {
                self.camera = Some(self.camera.map_or(0, |camera| (camera + 1) % self.cameras.len()));
            }
            Command::Vsync => self.vsync = !self.vsync,
            Command::Digit(digit) => {
                let light = self.first_digit + digit;
                if light < self.lights {
                    self.lights_on ^= 1 << light;
                }
            }
            Command::NextLights => {
                let next = self.first_digit + LIGHTS_AT_A_TIME;
                self.first_digit = if next < self.lights { next } else { 0 };
            }
            Command::Camera | Command::Path | Command::FullScreen | Command::Picture | Command::Leave => {}
            Command::Undo | Command::Redo => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn settings() -> Settings {
        Settings {
            predictor: Predictor::default(),
            quality: Quality::default(),
            mode: Mode::default(),
            guard: Guard::default(),
            view: DebugView::default(),
            split: Split::Off,
            tone: ToneCurve::default(),
            reference: true,
            cameras: Arc::default(),
            camera: None,
            lights: 3,
            lights_on: 0b111,
            first_digit: 0,
            vsync: true,
            overlay: true,
            help: false,
            edit: false,
        }
    }

    #[test]
    fn keys_cycle_through_every_choice() {
        for (command, steps) in [
            (Command::Predictor, 5),
            (Command::Mode, 3),
            (Command::Guard, 4),
            (Command::View, 8),
            (Command::Split, 3),
            (Command::Tone, 4),
        ] {
            let mut changed = settings();
            for step in 1..=steps {
                changed.apply(command);
                assert_eq!(changed == settings(), step == steps, "{command:?} after {step}: {changed:?}");
            }
        }
    }

    #[test]
    fn digits_beyond_the_last_light_do_nothing() {
        let mut changed = settings();
        changed.apply(Command::Digit(1));
        assert_eq!(changed.lights_on, 0b101);
        changed.apply(Command::Digit(3));
        assert_eq!(changed.lights_on, 0b101);
    }

    #[test]
    fn every_light_has_its_digit() {
        let mut changed = Settings { lights: 32, lights_on: 0, ..settings() };
        for expected in [(1, 9), (10, 18), (19, 27), (28, 32)] {
            assert_eq!(changed.digits(), expected);
            (0..LIGHTS_AT_A_TIME).for_each(|digit| changed.apply(Command::Digit(digit)));
            changed.apply(Command::NextLights);
        }
        assert_eq!((changed.lights_on, changed.digits()), (u32::MAX, (1, 9)));
        let mut few = settings();
        few.apply(Command::NextLights);
        assert_eq!(few.digits(), (1, 3));
    }

    #[test]
    fn a_key_goes_through_the_cameras_of_the_file() {
        let camera = |name: &str| NamedCamera {
            name: name.to_owned(),
            position_m: glam::DVec3::ZERO,
            orientation: glam::DQuat::IDENTITY,
            yfov_rad: 0.7,
        };
        let mut changed = settings();
        changed.apply(Command::Camera);
        assert_eq!(changed.camera, None);
        changed.set_cameras(&[camera("door"), camera("")]);
        assert_eq!(changed.cameras.iter().map(|camera| &*camera.name).collect::<Vec<_>>(), ["door", "2"]);
        for expected in [0, 1, 0] {
            changed.apply(Command::Camera);
            assert_eq!(changed.camera, Some(expected));
        }
        changed.set_cameras(&[]);
        assert_eq!(changed.camera, None);
    }

    #[test]
    fn a_reference_needs_a_server_beside_the_client() {
        let mut alone = Settings { reference: false, ..settings() };
        alone.apply(Command::Split);
        alone.apply(Command::Split);
        assert_eq!(alone.split, Split::Off);
    }

    #[test]
    fn after_a_guard_band_from_the_command_line_comes_the_first_of_the_list() {
        let mut changed = Settings { guard: "640x360".parse().unwrap(), ..settings() };
        changed.apply(Command::Guard);
        assert_eq!(changed.guard, GUARDS[0]);
    }
}

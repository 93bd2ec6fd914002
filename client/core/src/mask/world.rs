//! What people change in the scene: the states that the server has confirmed, and what this client has changed since.
//!
//! A picture shows the newest confirmed state with the client's own changes on top. A mask names the revision that it
//! was traced with, which is looked up here.

use std::{collections::VecDeque, sync::Arc, time::Duration};

use glam::{DQuat, DVec3, Vec3};
use gnomon_protocol::{
    edit as wire,
    limits::{KEPT_REVISIONS, MAX_EDITS},
    message::{Edited, ServerMessage, Welcome},
};
use gnomon_scene::{Edit, Edits, LightEdit, NodeEdit};
use thiserror::Error;
use web_time::Instant;

use super::pose_history::Rejection;

/// Least time between two messages with edits: half of what a server allows.
const PAUSE: Duration = Duration::from_millis(8);

/// Messages that the server has not answered; more wait.
const MOST_UNANSWERED: usize = 64;

/// Clocks that differ by more are set, and not led to each other.
const CLOCK_JUMP_S: f64 = 0.1;

#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
pub enum WorldError {
    #[error("the server does not let this client edit the scene")]
    NotAllowed,
}

/// How the server keeps its scene: Welcome says it.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Terms {
    pub may_edit: bool,
    /// All clients see one scene, whose state the server keeps. Otherwise each has its own, and brings its state along.
    pub shared: bool,
    /// Of the server's state.
    pub revision: u32,
}

impl From<&Welcome> for Terms {
    fn from(welcome: &Welcome) -> Self {
        Self { may_edit: welcome.may_edit, shared: welcome.shared_world, revision: welcome.revision }
    }
}

/// What a server says of its scene.
#[derive(Debug, Clone, PartialEq)]
pub enum News {
    Edited(Edited),
    Refused {
        number: u32,
    },
    /// Time of the scene, in microseconds.
    Clock(u64),
}

impl TryFrom<ServerMessage> for News {
    /// A message of another kind.
    type Error = ServerMessage;

    fn try_from(message: ServerMessage) -> Result<Self, ServerMessage> {
        match message {
            ServerMessage::Edited(edited) => Ok(Self::Edited(edited)),
            ServerMessage::EditRefused { number, reason } => {
                tracing::warn!(number, %reason, "the server refuses an edit");
                Ok(Self::Refused { number })
            }
            ServerMessage::Clock(clock_us) => Ok(Self::Clock(clock_us)),
            message => Err(message),
        }
    }
}

#[derive(Debug)]
pub struct World {
    /// `None` without a server: everything may be edited.
    terms: Option<Terms>,
    /// Confirmed states by revision, oldest first. Empty while the server's state is unknown.
    states: VecDeque<(u32, Arc<Edits>)>,
    /// Messages under way, oldest first.
    unanswered: VecDeque<(u32, Vec<Edit>)>,
    /// What no message has yet, one of each node and light.
    unsent: Vec<Edit>,
    drawn: Arc<Edits>,
    next_number: u32,
    sent_at: Option<Instant>,
    refused: u64,
    clock: Option<Clock>,
}

/// The server's clock.
#[derive(Debug, Clone, Copy)]
struct Clock {
    scene_time_s: f64,
    at: Instant,
}

impl Clock {
    fn time_s(&self, now: Instant) -> f64 {
        self.scene_time_s + now.saturating_duration_since(self.at).as_secs_f64()
    }
}

impl Default for World {
    fn default() -> Self {
        Self {
            terms: None,
            states: VecDeque::from([(0, Arc::default())]),
            unanswered: VecDeque::new(),
            unsent: Vec::new(),
            drawn: Arc::default(),
            next_number: 0,
            sent_at: None,
            refused: 0,
            clock: None,
        }
    }
}

impl World {
    /// Begins with a server, or with another connection to it. What this client has changed is sent again.
    pub fn begin(&mut self, terms: Terms) {
        let under_way = std::mem::take(&mut self.unanswered).into_iter().flat_map(|(_, edits)| edits);
        let newer = std::mem::take(&mut self.unsent);
        let own: Vec<Edit> = if terms.shared { under_way.chain(newer).collect() } else { self.drawn.iter().collect() };
        own.into_iter().for_each(|edit| put(&mut self.unsent, edit));
        self.states.clear();
        if terms.revision == 0 {
            self.states.push_back((0, Arc::default()));
        }
        if !terms.may_edit {
            self.unsent.clear();
        }
        (self.terms, self.sent_at, self.clock) = (Some(terms), None, None);
        self.draw();
    }

    /// Forgets everything: the scene is another one.
    pub fn forget(&mut self) {
        *self = Self { next_number: self.next_number, ..Self::default() };
    }

    /// Changes nodes and lights from the next picture on. The server checks what it is sent.
    ///
    /// # Errors
    /// If the server does not let this client edit.
    pub fn edit(&mut self, edits: &[Edit]) -> Result<(), WorldError> {
        if !self.may_edit() {
            return Err(WorldError::NotAllowed);
        }
        let drawn = Arc::make_mut(&mut self.drawn);
        for edit in edits {
            let is_so = match edit {
                Edit::Node(node, edit) => drawn.node(*node) == *edit,
                Edit::Light(light, edit) => drawn.light(*light) == *edit,
            };
            // A handle that is held still says the same again. What goes beyond the most, the server would refuse.
            if !is_so && drawn.apply(*edit).is_ok() {
                put(&mut self.unsent, *edit);
            }
        }
        Ok(())
    }

    /// Whether this client may edit the scene.
    #[must_use]
    pub fn may_edit(&self) -> bool {
        self.terms.is_none_or(|terms| terms.may_edit)
    }

    /// What the next picture shows.
    #[must_use]
    pub fn drawn(&self) -> &Arc<Edits> {
        &self.drawn
    }

    /// The newest confirmed revision.
    #[must_use]
    pub fn revision(&self) -> u32 {
        self.states.back().map_or(0, |(revision, _)| *revision)
    }

    /// Returns the state that a mask was traced with.
    ///
    /// # Errors
    /// If it is not known yet, or not any more.
    pub fn state(&self, revision: u32) -> Result<&Arc<Edits>, Rejection> {
        let found = self.states.iter().find(|(known, _)| *known == revision);
        let older = self.states.front().is_some_and(|(oldest, _)| revision < *oldest);
        let rejection = if older { Rejection::OldRevision } else { Rejection::UnknownRevision };
        found.map(|(_, state)| state).ok_or(rejection)
    }

    /// Returns the next message to send, with its number, if there is one now.
    pub fn next_message(&mut self, now: Instant) -> Option<(u32, Vec<wire::Edit>)> {
        let waits = self.sent_at.is_some_and(|sent| now.saturating_duration_since(sent) < PAUSE);
        if self.terms.is_none() || self.unsent.is_empty() || waits || self.unanswered.len() >= MOST_UNANSWERED {
            return None;
        }
        let edits: Vec<Edit> = self.unsent.drain(..self.unsent.len().min(MAX_EDITS)).collect();
        let (number, sent) = (self.next_number, edits.iter().map(to_wire).collect());
        self.next_number = self.next_number.wrapping_add(1);
        self.unanswered.push_back((number, edits));
        self.sent_at = Some(now);
        Some((number, sent))
    }

    /// Whether the server has not answered all that this client has changed.
    #[must_use]
    pub fn is_waiting(&self) -> bool {
        self.terms.is_some() && !(self.unsent.is_empty() && self.unanswered.is_empty())
    }

    /// Takes what the server says, half of `round_trip` before `now`.
    pub fn hear(&mut self, news: &News, round_trip: Duration, now: Instant) {
        match news {
            News::Edited(edited) => self.hear_edited(edited),
            News::Refused { number } => {
                self.refused += 1;
                self.answered(*number);
                self.draw();
            }
            News::Clock(clock_us) => self.hear_clock(*clock_us, round_trip, now),
        }
    }

    /// Takes a state that the server has confirmed.
    fn hear_edited(&mut self, edited: &Edited) {
        let before = self.states.back().filter(|_| !edited.whole).map(|(_, state)| Arc::clone(state));
        let mut state = before.unwrap_or_default();
        let changed = Arc::make_mut(&mut state);
        for edit in &edited.edits {
            // The server keeps no more than the most.
            let _ = changed.apply(from_wire(edit));
        }
        if edited.whole {
            self.states.clear();
        }
        self.states.push_back((edited.revision, state));
        while self.states.len() > KEPT_REVISIONS {
            self.states.pop_front();
        }
        if let Some(number) = edited.yours {
            self.answered(number);
        }
        self.draw();
    }

    /// Edits that the server has refused.
    #[must_use]
    pub fn refused(&self) -> u64 {
        self.refused
    }

    /// Answers come in the order of the messages.
    fn answered(&mut self, number: u32) {
        if let Some(place) = self.unanswered.iter().position(|(sent, _)| *sent == number) {
            self.unanswered.drain(..=place);
        }
    }

    fn draw(&mut self) {
        let mut drawn = self.states.back().map(|(_, state)| Arc::clone(state)).unwrap_or_default();
        let own: Vec<Edit> = self.unanswered.iter().flat_map(|(_, edits)| edits).chain(&self.unsent).copied().collect();
        if !own.is_empty() {
            let changed = Arc::make_mut(&mut drawn);
            for edit in own {
                let _ = changed.apply(edit);
            }
        }
        self.drawn = drawn;
    }

    fn hear_clock(&mut self, clock_us: u64, round_trip: Duration, now: Instant) {
        let read_s = Duration::from_micros(clock_us).as_secs_f64() + round_trip.as_secs_f64() * 0.5;
        let expected_s = self.clock.map_or(read_s, |clock| clock.time_s(now));
        let late_s = read_s - expected_s;
        let scene_time_s = if late_s.abs() > CLOCK_JUMP_S { read_s } else { expected_s + late_s * 0.125 };
        self.clock = Some(Clock { scene_time_s, at: now });
    }

    /// The scene's time by the server's clock, in seconds. `None` if this client has a scene of its own.
    #[must_use]
    pub fn scene_time_s(&self, now: Instant) -> Option<f64> {
        self.clock.map(|clock| clock.time_s(now))
    }
}

/// Replaces what was said of the same node or light.
fn put(edits: &mut Vec<Edit>, edit: Edit) {
    let target = |edit: &Edit| match edit {
        Edit::Node(node, _) => (false, *node),
        Edit::Light(light, _) => (true, *light),
    };
    match edits.iter_mut().find(|other| target(other) == target(&edit)) {
        Some(other) => *other = edit,
        None => edits.push(edit),
    }
}

fn to_wire(edit: &Edit) -> wire::Edit {
    match *edit {
        Edit::Node(node, NodeEdit { translation_m, rotation, scale, shown }) => wire::Edit::Node(wire::NodeEdit {
            node,
            translation_m: translation_m.map(|vector| vector.to_array()),
            rotation: rotation.map(|rotation| rotation.to_array()),
            scale: scale.map(|vector| vector.to_array()),
            shown,
        }),
        Edit::Light(light, LightEdit { position_m, direction, color, intensity, range_m, cone_rad }) => {
            wire::Edit::Light(wire::LightEdit {
                light,
                position_m: position_m.map(|vector| vector.to_array()),
                direction: direction.map(|vector| vector.to_array()),
                color: color.map(|color| color.to_array()),
                intensity,
                range_m,
                cone_rad,
            })
        }
    }
}

fn from_wire(edit: &wire::Edit) -> Edit {
    match *edit {
        wire::Edit::Node(wire::NodeEdit { node, translation_m, rotation, scale, shown }) => {
            let (translation_m, scale) = (translation_m.map(DVec3::from_array), scale.map(DVec3::from_array));
            Edit::Node(node, NodeEdit { translation_m, rotation: rotation.map(DQuat::from_array), scale, shown })
        }
        wire::Edit::Light(wire::LightEdit { light, position_m, direction, color, intensity, range_m, cone_rad }) => {
            let (position_m, direction) = (position_m.map(DVec3::from_array), direction.map(DVec3::from_array));
            let color = color.map(Vec3::from_array);
            Edit::Light(light, LightEdit { position_m, direction, color, intensity, range_m, cone_rad })
        }
    }
}

#[cfg(test)]
#[expect(clippy::disallowed_methods, reason = "tests have a clock")]
mod tests {
    use super::*;

    fn dimmed(light: u32, intensity: f32) -> Edit {
        Edit::Light(light, LightEdit { intensity: Some(intensity), ..LightEdit::default() })
    }

    fn confirmed(revision: u32, yours: Option<u32>, edits: Vec<wire::Edit>) -> Edited {
        Edited { revision, yours, whole: false, edits }
    }

    fn begun(terms: Terms) -> World {
        let mut world = World::default();
        world.begin(terms);
        world
    }

    const PRIVATE: Terms = Terms { may_edit: true, shared: false, revision: 0 };
    const SHARED: Terms = Terms { shared: true, ..PRIVATE };

    #[test]
    fn own_edits_are_drawn_at_once_and_stay_when_they_are_confirmed() {
        let (mut world, now) = (begun(PRIVATE), Instant::now());
        world.edit(&[dimmed(1, 2.0)]).unwrap();
        let drawn = Arc::clone(world.drawn());
        assert_eq!((drawn.light(1).intensity, world.revision()), (Some(2.0), 0));
        let (number, edits) = world.next_message(now).unwrap();
        assert!(world.state(0).unwrap().is_empty() && world.is_waiting());
        world.hear_edited(&confirmed(1, Some(number), edits));
        assert_eq!((world.drawn(), world.revision(), world.is_waiting()), (&drawn, 1, false));
        assert_eq!(world.state(1).unwrap(), &drawn);
    }

    #[test]
    fn messages_keep_their_distance_and_the_last_word_counts() {
        let (mut world, now) = (begun(PRIVATE), Instant::now());
        world.edit(&[dimmed(1, 2.0)]).unwrap();
        assert!(world.next_message(now).is_some());
        for step in 0..100_u8 {
            world.edit(&[dimmed(1, f32::from(step))]).unwrap();
            assert_eq!(world.next_message(now), None);
        }
        let (_, edits) = world.next_message(now + PAUSE).unwrap();
        assert_eq!(edits.iter().map(from_wire).collect::<Vec<_>>(), [dimmed(1, 99.0)]);
        // A server that answers nothing is not flooded.
        for step in 2..1000 {
            world.edit(&[dimmed(step, 1.0)]).unwrap();
            world.next_message(now + PAUSE * step);
        }
        assert_eq!(world.unanswered.len(), MOST_UNANSWERED);
    }

    #[test]
    fn what_is_refused_is_taken_back() {
        let (mut world, now) = (begun(PRIVATE), Instant::now());
        world.edit(&[dimmed(1, 2.0)]).unwrap();
        let (number, _) = world.next_message(now).unwrap();
        world.hear(&News::Refused { number }, Duration::ZERO, now);
        assert!(world.drawn().is_empty() && !world.is_waiting() && world.refused() == 1);
        let mut watching = begun(Terms { may_edit: false, ..PRIVATE });
        assert_eq!(watching.edit(&[dimmed(1, 2.0)]), Err(WorldError::NotAllowed));
        assert_eq!([&world, &watching, &World::default()].map(World::may_edit), [true, false, true]);
    }

    #[test]
    fn a_new_connection_brings_a_private_world_along_and_takes_a_shared_one() {
        let (mut own, mut shared, now) = (begun(PRIVATE), begun(SHARED), Instant::now());
        for world in [&mut own, &mut shared] {
            world.edit(&[dimmed(1, 2.0)]).unwrap();
            let (number, edits) = world.next_message(now).unwrap();
            world.hear_edited(&confirmed(1, Some(number), edits));
        }
        own.begin(PRIVATE);
        assert_eq!((own.drawn().light(1).intensity, own.revision()), (Some(2.0), 0));
        assert_eq!(own.next_message(now).unwrap().1.len(), 1);
        // Somebody has put out light 0 meanwhile, and lit light 1 again.
        shared.begin(Terms { revision: 7, ..SHARED });
        assert_eq!(shared.state(7), Err(Rejection::UnknownRevision));
        let edits = vec![to_wire(&dimmed(0, 0.0))];
        shared.hear_edited(&Edited { revision: 7, yours: None, whole: true, edits });
        assert_eq!((shared.drawn().light(0).intensity, shared.drawn().len()), (Some(0.0), 1));
        assert_eq!(shared.next_message(now + PAUSE), None);
    }

    #[test]
    fn states_are_remembered_for_a_while() {
        let mut world = begun(SHARED);
        let last = u32::try_from(KEPT_REVISIONS).unwrap() + 5;
        for revision in 1..=last {
            let edits = vec![to_wire(&dimmed(0, revision as f32))];
            world.hear_edited(&confirmed(revision, None, edits));
        }
        assert_eq!(world.state(5), Err(Rejection::OldRevision));
        assert_eq!(world.state(6).unwrap().light(0).intensity, Some(6.0));
        assert_eq!(world.state(last + 1), Err(Rejection::UnknownRevision));
    }

    #[test]
    fn the_clock_is_the_servers() {
        let (mut world, now) = (World::default(), Instant::now());
        assert_eq!(world.scene_time_s(now), None);
        world.hear_clock(5_000_000, Duration::from_millis(60), now);
        let later = now + Duration::from_secs(2);
        assert!((world.scene_time_s(later).unwrap() - 7.03).abs() < 1e-9);
        // A reading that came late moves it a little; another clock sets it.
        world.hear_clock(6_990_000, Duration::from_millis(60), later);
        assert!((world.scene_time_s(later).unwrap() - 7.03 + 0.00125).abs() < 1e-9);
        world.hear_clock(1_000_000, Duration::ZERO, later);
        assert!((world.scene_time_s(later).unwrap() - 1.0).abs() < 1e-9);
    }

    #[test]
    fn edits_travel_unchanged() {
        let node = NodeEdit {
            translation_m: Some(DVec3::new(1.0, 2.0, 3.0)),
            rotation: Some(DQuat::from_rotation_y(0.3)),
            scale: Some(DVec3::splat(0.5)),
            shown: Some(false),
        };
        let light = LightEdit {
            position_m: Some(DVec3::NEG_ONE),
            direction: Some(DVec3::NEG_Y),
            color: Some(Vec3::new(0.1, 0.2, 0.3)),
            intensity: Some(4.0),
            range_m: Some(f32::INFINITY),
            cone_rad: Some([0.1, 0.2]),
        };
        for edit in [Edit::Node(7, node), Edit::Light(3, light), Edit::Node(0, NodeEdit::default())] {
            assert_eq!(from_wire(&to_wire(&edit)), edit);
        }
    }
}

//! What clients have changed in the scene: the newest state, its revision, and the latest changes.
//!
//! Each session has a world of its own, or all share one (`--shared-world`). Masks are traced with its newest state.

use std::{
    collections::{BTreeMap, VecDeque},
    sync::Arc,
    time::Instant,
};

use glam::{DQuat, DVec3, Vec3};
use gnomon_protocol::{
    edit as wire,
    ids::SessionId,
    limits::{KEPT_REVISIONS, MAX_EDITED},
    message::{Edited, ServerMessage},
};
use gnomon_scene::{Edit, EditError, Edits, LightEdit, NodeEdit, Scene};
use parking_lot::Mutex;
use tokio::sync::watch;

const _: () = assert!(MAX_EDITED == gnomon_scene::limits::MAX_EDITED);

#[derive(Debug)]
pub(crate) struct World {
    state: Mutex<State>,
    revision: watch::Sender<u32>,
    began: Instant,
}

#[derive(Debug, Default)]
struct State {
    newest: Newest,
    /// What differs from the file, as it travels, by kind and index.
    changed: BTreeMap<(bool, u32), wire::Edit>,
    /// The latest changes, oldest first.
    log: VecDeque<Change>,
}

/// A state to trace.
#[derive(Debug, Clone, Default)]
pub(crate) struct Newest {
    pub(crate) revision: u32,
    pub(crate) edits: Arc<Edits>,
}

#[derive(Debug)]
struct Change {
    revision: u32,
    by: SessionId,
    number: u32,
    edits: Vec<wire::Edit>,
}

impl World {
    /// The scene as its file has it, at time 0 now.
    pub(crate) fn new(now: Instant) -> Self {
        Self { state: Mutex::default(), revision: watch::Sender::new(0), began: now }
    }

    pub(crate) fn newest(&self) -> Newest {
        self.state.lock().newest.clone()
    }

    /// Told of each new revision.
    pub(crate) fn subscribe(&self) -> watch::Receiver<u32> {
        self.revision.subscribe()
    }

    /// Time of the scene, in microseconds.
    pub(crate) fn clock_us(&self, now: Instant) -> u64 {
        u64::try_from(now.saturating_duration_since(self.began).as_micros()).unwrap_or(u64::MAX)
    }

    /// Takes all changes of a message, or none. `stage` has the scene's nodes and lights.
    /// Errors if one is not legal, or there are too many.
    pub(crate) fn edit(
        &self,
        (by, number): (SessionId, u32),
        edits: Vec<wire::Edit>,
        stage: &Scene,
    ) -> Result<(), EditError> {
        let checked = edits.iter().map(|edit| {
            let edit = from_wire(edit);
            edit.check(stage).map(|()| edit)
        });
        let checked: Vec<Edit> = checked.collect::<Result<_, _>>()?;
        let mut state = self.state.lock();
        let mut changed = Arc::clone(&state.newest.edits);
        let all = Arc::make_mut(&mut changed);
        checked.iter().try_for_each(|edit| all.apply(*edit))?;
        let State { newest, changed: list, log } = &mut *state;
        for edit in &edits {
            let (target, is_of_file) = match edit {
                wire::Edit::Node(edit) => {
                    ((false, edit.node), *edit == wire::NodeEdit { node: edit.node, ..Default::default() })
                }
                wire::Edit::Light(edit) => {
                    ((true, edit.light), *edit == wire::LightEdit { light: edit.light, ..Default::default() })
                }
            };
            if is_of_file {
                list.remove(&target);
            } else {
                list.insert(target, *edit);
            }
        }
        *newest = Newest { revision: newest.revision.wrapping_add(1), edits: changed };
        let revision = newest.revision;
        log.push_back(Change { revision, by, number, edits });
        while log.len() > KEPT_REVISIONS {
            log.pop_front();
        }
        self.revision.send_replace(revision);
        Ok(())
    }

    /// Returns what a session has not been told since revision `told`, which becomes the newest.
    pub(crate) fn since(&self, told: &mut u32, session: SessionId) -> Vec<Edited> {
        let state = self.state.lock();
        let before = std::mem::replace(told, state.newest.revision);
        let missing = state.log.iter().filter(|change| change.revision > before);
        let told = |change: &Change| Edited {
            revision: change.revision,
            yours: (change.by == session).then_some(change.number),
            whole: false,
            edits: change.edits.clone(),
        };
        let reaches_back = state.log.front().is_none_or(|oldest| oldest.revision <= before.wrapping_add(1));
        if reaches_back {
            return missing.map(told).collect();
        }
        let yours = missing.filter(|change| change.by == session).map(|change| change.number).next_back();
        vec![Edited { yours, ..state.whole() }]
    }

    /// Returns the whole state, for one who knows nothing of it.
    pub(crate) fn whole(&self) -> Edited {
        self.state.lock().whole()
    }
}

/// A session's part in a world.
#[derive(Debug)]
pub(crate) struct WorldOf {
    pub(crate) world: Arc<World>,
    session: SessionId,
    pub(crate) shared: bool,
    pub(crate) may_edit: bool,
    /// Revision that the client knows, or will when it has the whole state.
    pub(crate) told: u32,
}

impl WorldOf {
    pub(crate) fn own(world: World, session: SessionId, may_edit: bool) -> Self {
        Self { world: Arc::new(world), session, shared: false, may_edit, told: 0 }
    }

    pub(crate) fn shared(world: &Arc<World>, session: SessionId, may_edit: bool) -> Self {
        Self { world: Arc::clone(world), session, shared: true, may_edit, told: world.newest().revision }
    }

    /// Returns what the client must know before its first mask.
    pub(crate) fn begin(&mut self) -> Option<ServerMessage> {
        (self.told != 0).then(|| {
            let whole = self.world.whole();
            self.told = whole.revision;
            ServerMessage::Edited(whole)
        })
    }

    /// Returns what is new to the client.
    pub(crate) fn news(&mut self) -> impl Iterator<Item = ServerMessage> {
        self.world.since(&mut self.told, self.session).into_iter().map(ServerMessage::Edited)
    }

    /// Takes all changes of a message, or none. `stage` has the scene's nodes and lights.
    /// Errors with the reason for the client.
    pub(crate) fn edit(&self, number: u32, edits: Vec<wire::Edit>, stage: &Scene) -> Result<(), String> {
        if !self.may_edit {
            return Err("this client's token has not the scope edit".to_owned());
        }
        self.world.edit((self.session, number), edits, stage).map_err(|error| error.to_string())
    }

    /// The time to tell a client of a shared world.
    pub(crate) fn clock(&self) -> Option<ServerMessage> {
        self.shared.then(|| ServerMessage::Clock(self.world.clock_us(Instant::now())))
    }
}

impl State {
    fn whole(&self) -> Edited {
        let edits = self.changed.values().copied().collect();
        Edited { revision: self.newest.revision, yours: None, whole: true, edits }
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
mod tests {
    use super::*;
    use crate::visibility::test_scenes;

    const ME: SessionId = SessionId(1);
    const OTHER: SessionId = SessionId(2);

    fn dimmed(light: u32, intensity: f32) -> Vec<wire::Edit> {
        vec![wire::Edit::Light(wire::LightEdit { light, intensity: Some(intensity), ..Default::default() })]
    }

    fn world() -> World {
        World::new(Instant::now())
    }

    #[test]
    fn sessions_are_told_what_is_new_to_them() {
        let (world, stage) = (world(), test_scenes::room());
        let (mut mine, mut others) = (0, 0);
        world.edit((ME, 7), dimmed(0, 2.0), &stage).unwrap();
        let told = Edited { revision: 1, yours: Some(7), whole: false, edits: dimmed(0, 2.0) };
        assert_eq!(world.since(&mut mine, ME), std::slice::from_ref(&told));
        assert_eq!(world.since(&mut others, OTHER), [Edited { yours: None, ..told.clone() }]);
        assert_eq!((world.since(&mut mine, ME), mine, others), (vec![], 1, 1));
        assert_eq!(world.whole(), Edited { yours: None, whole: true, ..told });
        assert_eq!(world.newest().edits.light(0).intensity, Some(2.0));
        // What is put back is no change any more.
        world.edit((ME, 8), vec![wire::Edit::Light(wire::LightEdit::default())], &stage).unwrap();
        assert_eq!((world.whole().edits, world.newest().edits.is_empty()), (vec![], true));
    }

    #[test]
    fn who_lags_far_behind_is_told_the_whole() {
        let (world, stage) = (world(), test_scenes::room());
        for number in 0..u32::try_from(KEPT_REVISIONS).unwrap() + 1 {
            world.edit((OTHER, number), dimmed(number % 2, number as f32), &stage).unwrap();
        }
        let mut told = 0;
        let whole = world.since(&mut told, OTHER);
        assert!(matches!(&whole[..], [Edited { whole: true, yours: Some(64), edits, .. }] if edits.len() == 2));
        let mut told = 1;
        assert_eq!(world.since(&mut told, ME).len(), KEPT_REVISIONS);
    }

    #[test]
    fn what_is_not_legal_changes_nothing() {
        let (world, stage) = (world(), test_scenes::room());
        let node = |node, edit| wire::Edit::Node(wire::NodeEdit { node, ..edit });
        let light = |edit| vec![wire::Edit::Light(edit)];
        let bad = [
            light(wire::LightEdit { light: 99, ..Default::default() }),
            light(wire::LightEdit { intensity: Some(f32::NAN), ..Default::default() }),
            light(wire::LightEdit { intensity: Some(-1.0), ..Default::default() }),
            light(wire::LightEdit { position_m: Some([f64::INFINITY; 3]), ..Default::default() }),
            light(wire::LightEdit { position_m: Some([2e9; 3]), ..Default::default() }),
            light(wire::LightEdit { direction: Some([0.5; 3]), ..Default::default() }),
            light(wire::LightEdit { color: Some([-0.1, 0.0, 0.0]), ..Default::default() }),
            light(wire::LightEdit { range_m: Some(0.0), ..Default::default() }),
            light(wire::LightEdit { cone_rad: Some([0.3, 0.2]), ..Default::default() }),
            vec![node(0, wire::NodeEdit::default())],
            [dimmed(0, 1.0), vec![node(u32::MAX, wire::NodeEdit::default())]].concat(),
        ];
        for edits in bad {
            assert!(world.edit((ME, 0), edits.clone(), &stage).is_err(), "{edits:?}");
        }
        assert_eq!((world.newest().revision, world.newest().edits.is_empty()), (0, true));
    }
}

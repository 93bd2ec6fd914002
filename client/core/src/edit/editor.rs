//! The thing that is chosen, the drag of its handles, and what was done to it.

use glam::{DQuat, DVec2, DVec3};
use gnomon_scene::{Edit, LightEdit, LightKind, NodeAt, NodeEdit, Scene, SceneAt, camera::Space};

use super::{
    Target, change,
    drag::{Drag, Motion},
    handles::{Gizmo, Handle, Kinds},
    history::History,
    stage::{Posed, Stage},
    view::View,
};

/// How far before the camera the handles of a light without a place are, in distances of the near plane.
const BEFORE_CAMERA: f64 = 100.0;

/// Edits a scene by hand.
///
/// Methods that return edits do not change the scene: they are for
/// [`FrameLoop::edit`](crate::frame::frame_loop::FrameLoop::edit), and show in the state of the next frame.
#[derive(Debug)]
pub struct Editor {
    pub stage: Stage,
    selected: Option<Target>,
    held: Option<Held>,
    history: History,
}

/// A handle that is held, and how its thing was.
#[derive(Debug, Clone, Copy)]
struct Held {
    drag: Drag,
    pivot: DVec3,
    before: Before,
}

#[derive(Debug, Clone, Copy)]
enum Before {
    Node(u32, NodeAt, NodeEdit),
    Light(u32, LightAt, LightEdit),
}

/// Where a light is, and where it shines, in the world.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LightAt {
    pub kind: LightKind,
    /// In metres. A directional light's is of no use.
    pub position_m: DVec3,
    /// A unit vector. A point light's is of no use.
    pub direction: DVec3,
}

impl Editor {
    #[must_use]
    pub fn new(scene: Scene) -> Self {
        Self { stage: Stage::new(scene), selected: None, held: None, history: History::default() }
    }

    #[must_use]
    pub fn selected(&self) -> Option<Target> {
        self.selected
    }

    /// Chooses something else, or nothing.
    pub fn select(&mut self, target: Option<Target>) {
        if target != self.selected {
            self.settle();
            self.selected = target;
        }
    }

    #[must_use]
    pub fn space(&self) -> Space {
        Space::of(self.stage.scene())
    }

    /// Returns what is under a pixel: a lamp whose marker is within `reach_px`, or else the nearest surface's node.
    #[must_use]
    pub fn pick(&self, view: &View, posed: &Posed, px: DVec2, reach_px: f64) -> Option<Target> {
        let lamps = self.lamps(view, posed).map(|(light, at)| (at.distance(px), light));
        let near = lamps.filter(|(distance, _)| *distance <= reach_px);
        let lamp = near.min_by(|one, other| one.0.total_cmp(&other.0));
        lamp.map(|(_, light)| Target::Light(light)).or_else(|| {
            let hit = self.stage.nearest(view.camera.position_m, view.ray(px), posed)?;
            hit.node.map(Target::Node)
        })
    }

    /// Returns the lamps before the camera, each with its pixel.
    pub fn lamps(&self, view: &View, posed: &Posed) -> impl Iterator<Item = (u32, DVec2)> {
        let lamps = (0..).zip(&posed.lights).filter(|(_, light)| light.kind != LightKind::Directional);
        lamps.filter_map(|(number, light)| {
            let there = self.stage.scene().origin_m + light.position.as_dvec3();
            Some((number, view.project(there)?))
        })
    }

    /// Returns where a light is.
    #[must_use]
    pub fn light_at(&self, light: u32, posed: &Posed) -> Option<LightAt> {
        let light = posed.lights.get(light as usize)?;
        let position_m = self.stage.scene().origin_m + light.position.as_dvec3();
        Some(LightAt { kind: light.kind, position_m, direction: light.direction.as_dvec3().normalize_or(DVec3::NEG_Y) })
    }

    /// Returns the handles of what is chosen. `None` if it has none that can be seen.
    #[must_use]
    pub fn gizmo(&self, view: &View, posed: &Posed, radius_px: f64) -> Option<Gizmo> {
        let (pivot, kinds) = match self.selected? {
            Target::Node(node) => {
                let at = self.stage.scene().node_at(node, &posed.at)?;
                let outline = self.stage.outline(node, posed);
                if !at.visible && outline.is_none() {
                    return None;
                }
                let middle = outline.map(|corners| (corners[0] + corners[7]) * 0.5);
                let kinds = Kinds { moves: true, turns: true, scales: true };
                (middle.unwrap_or_else(|| at.world_from_node().w_axis.truncate()), kinds)
            }
            Target::Light(light) => {
                let LightAt { kind, position_m, .. } = self.light_at(light, posed)?;
                let moves = kind != LightKind::Directional;
                let before = view.camera.position_m + view.forward() * view.near_m * BEFORE_CAMERA;
                let kinds = Kinds { moves, turns: kind != LightKind::Point, scales: false };
                (if moves { position_m } else { before }, kinds)
            }
        };
        // A box that turns has another middle, but what is held turns around one place.
        let turning = self.held.filter(|held| matches!(held.drag.handle(), Handle::Turn(_) | Handle::Scale));
        Gizmo::around(view, turning.filter(|_| kinds.moves).map_or(pivot, |held| held.pivot), radius_px, kinds)
    }

    /// Takes hold of a handle under a pixel. Returns whether there is one.
    pub fn grab(&mut self, view: &View, posed: &Posed, gizmo: &Gizmo, (px, reach_px): (DVec2, f64)) -> bool {
        self.settle();
        let held = gizmo.at(px, reach_px).and_then(|handle| {
            let drag = Drag::begin(view, gizmo, handle, px)?;
            let before = match self.selected? {
                Target::Node(node) => {
                    Before::Node(node, self.stage.scene().node_at(node, &posed.at)?, posed.at.edits.node(node))
                }
                Target::Light(light) => Before::Light(light, self.light_at(light, posed)?, posed.at.edits.light(light)),
            };
            Some(Held { drag, pivot: gizmo.pivot, before })
        });
        self.held = held;
        held.is_some()
    }

    #[must_use]
    pub fn holds(&self) -> Option<Handle> {
        self.held.map(|held| held.drag.handle())
    }

    /// Returns what the handle that is held makes of its thing when the pointer is at a pixel.
    pub fn drag_to(&mut self, view: &View, px: DVec2) -> Option<Edit> {
        let Held { drag, pivot, before } = self.held?;
        let motion = drag.motion(view, px)?;
        let (before, after) = match before {
            Before::Node(number, node, edited) => {
                let after = match motion {
                    Motion::Move(by) => change::moved(&node, by),
                    Motion::Turn(axis, angle_rad) => change::turned(&node, pivot, axis, angle_rad),
                    Motion::Scale(factor) => change::scaled(&node, pivot, factor),
                }?;
                let edit = change::with_changes(edited, &node, &after);
                (Edit::Node(number, edited), Edit::Node(number, edit))
            }
            Before::Light(number, light, edited) => {
                let edit = match motion {
                    Motion::Move(by) => LightEdit { position_m: Some(light.position_m + by), ..edited },
                    Motion::Turn(axis, angle_rad) => {
                        let direction = DQuat::from_axis_angle(axis, angle_rad) * light.direction;
                        LightEdit { direction: Some(direction.normalize()), ..edited }
                    }
                    Motion::Scale(_) => edited,
                };
                (Edit::Light(number, edited), Edit::Light(number, edit))
            }
        };
        self.change_from(before, after)
    }

    /// Returns the edit if the scene may be so. What is drawn has the thing as it was, in `at`. Until [`Self::settle`],
    /// changes of one thing are one step.
    pub fn change(&mut self, at: &SceneAt, edit: Edit) -> Option<Edit> {
        let before = match edit {
            Edit::Node(node, _) => Edit::Node(node, at.edits.node(node)),
            Edit::Light(light, _) => Edit::Light(light, at.edits.light(light)),
        };
        self.change_from(before, edit)
    }

    fn change_from(&mut self, before: Edit, after: Edit) -> Option<Edit> {
        after.check(self.stage.scene()).ok()?;
        self.history.change(before, after);
        Some(after)
    }

    /// Ends a change: nothing is held any more.
    pub fn settle(&mut self) {
        self.held = None;
        self.history.settle();
    }

    /// Gives up a drag. Returns the edit that takes it back, if it has changed something.
    pub fn cancel(&mut self) -> Option<Edit> {
        self.held.take().and_then(|_| self.history.cancel())
    }

    /// Returns the edit that takes the last step back, and chooses its thing.
    pub fn undo(&mut self) -> Option<Edit> {
        self.held = None;
        let edit = self.history.undo();
        self.show(edit)
    }

    /// Returns the edit that does again what was undone last, and chooses its thing.
    pub fn redo(&mut self) -> Option<Edit> {
        self.held = None;
        let edit = self.history.redo();
        self.show(edit)
    }

    fn show(&mut self, edit: Option<Edit>) -> Option<Edit> {
        self.selected = edit.as_ref().map(Target::of).or(self.selected);
        edit
    }

    #[must_use]
    pub fn history(&self) -> &History {
        &self.history
    }
}

//! What is undone and done again: a step for each change of one thing, however many pictures it took.

use std::collections::VecDeque;

use gnomon_scene::Edit;

use super::Target;

/// Steps that are remembered.
const MOST_STEPS: usize = 1000;

/// A node or light, before and after. Each edit is a whole state, so that taking back is an edit too.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Step {
    before: Edit,
    after: Edit,
}

#[derive(Debug, Default)]
pub struct History {
    /// Oldest first.
    done: VecDeque<Step>,
    /// The next to be done again last.
    undone: Vec<Step>,
    /// The change under way.
    open: Option<Step>,
}

impl History {
    /// Takes a change from one state to another. It goes on with the change under way, if that is of the same node or
    /// light.
    pub fn change(&mut self, before: Edit, after: Edit) {
        match &mut self.open {
            Some(step) if Target::of(&step.after) == Target::of(&after) => step.after = after,
            _ => {
                self.settle();
                self.open = Some(Step { before, after });
            }
        }
    }

    /// Ends the change under way: it is a step from now on.
    pub fn settle(&mut self) {
        let Some(step) = self.open.take().filter(|step| step.before != step.after) else { return };
        self.undone.clear();
        if self.done.len() >= MOST_STEPS {
            self.done.pop_front();
        }
        self.done.push_back(step);
    }

    /// Takes back the change under way, or else the last step.
    pub fn undo(&mut self) -> Option<Edit> {
        self.settle();
        let step = self.done.pop_back()?;
        self.undone.push(step);
        Some(step.before)
    }

    /// Drops the change under way, as if it had not begun. Returns the edit that takes it back.
    pub fn cancel(&mut self) -> Option<Edit> {
        self.open.take().map(|step| step.before)
    }

    pub fn redo(&mut self) -> Option<Edit> {
        self.settle();
        let step = self.undone.pop()?;
        self.done.push_back(step);
        Some(step.after)
    }

    #[must_use]
    pub fn can_undo(&self) -> bool {
        self.open.is_some() || !self.done.is_empty()
    }

    #[must_use]
    pub fn can_redo(&self) -> bool {
        self.open.is_none() && !self.undone.is_empty()
    }
}

#[cfg(test)]
mod tests {
    use gnomon_scene::LightEdit;

    use super::*;

    fn light(light: u32, intensity: Option<f32>) -> Edit {
        Edit::Light(light, LightEdit { intensity, ..LightEdit::default() })
    }

    #[test]
    fn a_drag_is_one_step_and_goes_back_to_the_file() {
        let mut history = History::default();
        assert_eq!((history.undo(), history.redo()), (None, None));
        let (file, half) = (light(0, None), light(0, Some(0.5)));
        for intensity in [0.9, 0.7, 0.5] {
            history.change(file, light(0, Some(intensity)));
        }
        history.settle();
        history.change(half, light(0, Some(2.0)));
        history.settle();
        assert_eq!((history.undo(), history.undo(), history.undo()), (Some(half), Some(file), None));
        assert!(history.can_redo() && !history.can_undo());
        assert_eq!((history.redo(), history.redo(), history.redo()), (Some(half), Some(light(0, Some(2.0))), None));
    }

    #[test]
    fn another_thing_is_another_step_and_a_new_step_ends_what_was_undone() {
        let mut history = History::default();
        history.change(light(0, None), light(0, Some(1.0)));
        history.change(light(1, None), light(1, Some(2.0)));
        // Undoing ends the change under way first.
        assert_eq!((history.undo(), history.undo()), (Some(light(1, None)), Some(light(0, None))));
        history.change(light(2, None), light(2, Some(3.0)));
        history.settle();
        assert_eq!(history.redo(), None);
        assert_eq!(history.undo(), Some(light(2, None)));
    }

    #[test]
    fn what_changes_nothing_or_is_dropped_is_no_step() {
        let mut history = History::default();
        history.change(light(0, Some(1.0)), light(0, Some(1.0)));
        history.settle();
        assert!(!history.can_undo());
        history.change(light(0, None), light(0, Some(1.0)));
        assert_eq!((history.cancel(), history.cancel()), (Some(light(0, None)), None));
        assert_eq!(history.undo(), None);
    }

    #[test]
    fn the_oldest_steps_are_forgotten() {
        let mut history = History::default();
        let state = |step: usize| light(0, Some(step as f32));
        for step in 0..MOST_STEPS + 5 {
            history.change(state(step), state(step + 1));
            history.settle();
        }
        let undone: Vec<Edit> = std::iter::from_fn(|| history.undo()).collect();
        assert_eq!((undone.len(), undone.last().copied()), (MOST_STEPS, Some(state(5))));
    }
}

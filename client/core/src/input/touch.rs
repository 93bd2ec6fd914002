//! Touch input: one finger looks around, two walk.

const MOST_FINGERS: usize = 4;

/// Travel of two fingers for full speed, as a share of the window's height.
const FULL_SPEED: f64 = 0.2;

#[derive(Debug, Clone, Copy, PartialEq)]
struct Finger {
    id: u64,
    began_px: (f64, f64),
    at_px: (f64, f64),
}

#[derive(Debug, Clone, Default, PartialEq)]
pub struct Touches {
    fingers: Vec<Finger>,
    look_px: (f64, f64),
}

impl Touches {
    /// Starts following a finger.
    pub fn begin(&mut self, id: u64, x: f64, y: f64) {
        self.end(id);
        if self.fingers.len() < MOST_FINGERS {
            self.fingers.push(Finger { id, began_px: (x, y), at_px: (x, y) });
            // Two fingers walk from where they are when the second one touches.
            for finger in &mut self.fingers {
                finger.began_px = finger.at_px;
            }
        }
    }

    /// Moves a finger.
    pub fn go(&mut self, id: u64, x: f64, y: f64) {
        let alone = self.fingers.len() == 1;
        if let Some(finger) = self.fingers.iter_mut().find(|finger| finger.id == id) {
            if alone {
                self.look_px.0 += x - finger.at_px.0;
                self.look_px.1 += y - finger.at_px.1;
            }
            finger.at_px = (x, y);
        }
    }

    /// Ends a finger's touch.
    pub fn end(&mut self, id: u64) {
        self.fingers.retain(|finger| finger.id != id);
    }

    /// Returns how far one finger has turned the view since the last call, in pixels.
    pub(crate) fn take_look_px(&mut self) -> (f64, f64) {
        std::mem::take(&mut self.look_px)
    }

    /// Returns the walking speed of two fingers, to the right and ahead, each −1 to 1.
    pub(crate) fn walk(&self, height_px: f64) -> (f64, f64) {
        let [one, other, ..] = self.fingers.as_slice() else { return (0.0, 0.0) };
        let mean = |of: fn(&Finger) -> f64| (of(one) + of(other)) / 2.0 / (FULL_SPEED * height_px.max(1.0));
        let right = mean(|finger| finger.at_px.0 - finger.began_px.0);
        let ahead = mean(|finger| finger.began_px.1 - finger.at_px.1);
        (right.clamp(-1.0, 1.0), ahead.clamp(-1.0, 1.0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_finger_looks() {
        let mut touches = Touches::default();
        touches.begin(7, 100.0, 100.0);
        touches.go(7, 130.0, 90.0);
        assert_eq!(touches.walk(500.0), (0.0, 0.0));
        assert_eq!(touches.take_look_px(), (30.0, -10.0));
        assert_eq!(touches.take_look_px(), (0.0, 0.0));
        touches.end(7);
        touches.go(7, 0.0, 0.0);
        assert_eq!(touches, Touches::default());
    }

    #[test]
    fn two_fingers_walk_and_do_not_look() {
        let mut touches = Touches::default();
        touches.begin(1, 100.0, 300.0);
        touches.go(1, 100.0, 280.0);
        let _ = touches.take_look_px();
        touches.begin(2, 200.0, 280.0);
        assert_eq!(touches.walk(500.0), (0.0, 0.0), "no motion yet");
        touches.go(1, 150.0, 230.0);
        touches.go(2, 250.0, 230.0);
        assert_eq!(touches.walk(500.0), (0.5, 0.5));
        assert_eq!(touches.take_look_px(), (0.0, 0.0));
        touches.go(2, 250.0, -9000.0);
        assert_eq!(touches.walk(500.0).1, 1.0);
        touches.end(1);
        assert_eq!(touches.walk(500.0), (0.0, 0.0));
    }

    #[test]
    fn fingers_are_bounded() {
        let mut touches = Touches::default();
        (0..1000).for_each(|id| touches.begin(id, 0.0, 0.0));
        assert_eq!(touches.fingers.len(), MOST_FINGERS);
    }
}

//! The Pareto front: points that no other point beats in both directions.

/// The better end of an axis.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Better {
    /// Less is better: bytes, error, time.
    Low,
    /// More is better: quality, rate.
    High,
}

impl Better {
    fn cost(self, value: f64) -> f64 {
        match self {
            Self::Low => value,
            Self::High => -value,
        }
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Front {
    pub x: Better,
    pub y: Better,
}

impl Front {
    /// Returns the front by rising x. Of equal points one stays; points that are not finite are left out.
    pub fn of(self, points: &[(f64, f64)]) -> Vec<(f64, f64)> {
        let mut by_cost: Vec<_> = points.iter().copied().filter(|(x, y)| x.is_finite() && y.is_finite()).collect();
        by_cost.sort_by(|a, b| {
            let by_x = self.x.cost(a.0).total_cmp(&self.x.cost(b.0));
            by_x.then(self.y.cost(a.1).total_cmp(&self.y.cost(b.1)))
        });
        let mut best = f64::INFINITY;
        let mut front: Vec<_> = by_cost
            .into_iter()
            .filter(|point| {
                let cost = self.y.cost(point.1);
                let stays = cost < best;
                best = best.min(cost);
                stays
            })
            .collect();
        front.sort_by(|a, b| a.0.total_cmp(&b.0));
        front
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn beaten_points_are_left_out() {
        let points = [(1.0, 5.0), (2.0, 3.0), (2.0, 4.0), (3.0, 3.0), (4.0, 1.0), (4.0, 1.0), (0.0, f64::NAN)];
        let low = Front { x: Better::Low, y: Better::Low };
        assert_eq!(low.of(&points), [(1.0, 5.0), (2.0, 3.0), (4.0, 1.0)]);
        let high = Front { x: Better::High, y: Better::High };
        assert_eq!(high.of(&points), [(1.0, 5.0), (2.0, 4.0), (3.0, 3.0), (4.0, 1.0)]);
    }

    proptest! {
        #[test]
        fn the_front_beats_the_rest_and_nothing_beats_the_front(
            points in prop::collection::vec((0.0..9.0_f64, 0.0..9.0_f64), 1..40),
        ) {
            let front = Front { x: Better::Low, y: Better::High }.of(&points);
            let beats = |a: &(f64, f64), b: &(f64, f64)| a != b && a.0 <= b.0 && a.1 >= b.1;
            for point in &points {
                let beaten = points.iter().any(|other| beats(other, point));
                prop_assert_eq!(front.contains(point), !beaten);
            }
        }
    }
}

//! Motion since the reference: one vector for all lights of a place, because it is the camera that moves.
//!
//! A vector is predicted from the place above, otherwise from the one to the left, if they are in the slice. The
//! encoder tries the vectors around and those of the frame before, and then searches step by step.

use super::{
    bit_model::BitModel,
    block::DecodedBlock,
    order::Place,
    range::BinaryCoder,
    reference::{MAX_MOTION_PX, Reference, Vector},
};

/// Assumed cost of a vector that differs from the prediction, in wrong pixels.
const OWN_COST: u32 = 2;

/// Wrong pixels per light above which far steps are tried.
const FAR_COST: u32 = 24;

/// Reach of the exhaustive search, across and down.
const FAR_PX: [i16; 2] = [24, 12];

#[derive(Debug, Clone)]
pub(super) struct MotionModels {
    pub(super) own: [BitModel; 2],
    pub(super) axes: [AxisModels; 2],
}

/// Models of a vector's difference from the predicted one, on one axis.
#[derive(Debug, Clone, Copy)]
pub(super) struct AxisModels {
    pub(super) differs: [BitModel; 2],
    pub(super) negative: BitModel,
    /// By the number of bits so far.
    pub(super) longer: [BitModel; 12],
    pub(super) rest: [BitModel; 12],
}

/// Codes a vector and returns it, or `None` if it is too long, which no encoder makes.
pub(super) fn code(
    bits: &mut impl BinaryCoder,
    models: &mut MotionModels,
    certain: bool,
    predicted: Vector,
    truth: Vector,
) -> Option<Vector> {
    if !bits.bit(&mut models.own[usize::from(certain)], truth != predicted) {
        return Some(predicted);
    }
    let [across, down] = &mut models.axes;
    // Vectors are at most 2⁹ long, so differences are within 16 bits.
    let x = code_difference(bits, across, false, truth.x - predicted.x);
    let y = code_difference(bits, down, x != 0, truth.y - predicted.y);
    predicted.plus(x, y)
}

/// Codes a sign and an Elias γ code with adaptive bits.
fn code_difference(bits: &mut impl BinaryCoder, models: &mut AxisModels, other: bool, truth: i16) -> i16 {
    if !bits.bit(&mut models.differs[usize::from(other)], truth != 0) {
        return 0;
    }
    let negative = bits.bit(&mut models.negative, truth < 0);
    let length = truth.unsigned_abs();
    let mut more = 0;
    // 2¹⁰ is the longest difference: 11 bits.
    while more < 11 && bits.bit(&mut models.longer[more], length >> more > 1) {
        more += 1;
    }
    let mut number = 1;
    for place in (0..more).rev() {
        number = number << 1 | i16::from(bits.bit(&mut models.rest[place], length >> place & 1 == 1));
    }
    if negative { -number } else { number }
}

/// Searches for the vector of a place.
pub(super) struct Search<'a> {
    pub(super) reference: &'a Reference,
    /// Place of the first light.
    pub(super) place: Place,
    /// Blocks of the lights, from the first on.
    pub(super) own: &'a [DecodedBlock],
    pub(super) predicted: Vector,
}

impl Search<'_> {
    /// Returns the vector's cost in wrong pixels. Stops counting at `limit`.
    fn cost(&self, vector: Vector, limit: u32) -> u32 {
        let mut cost = if vector == self.predicted { 0 } else { OWN_COST };
        for (light, own) in (self.place.light..).zip(self.own) {
            let moved = self.reference.block(Place { light, ..self.place }, vector);
            cost += own.rows.iter().zip(moved).map(|(own, moved)| (own ^ moved).count_ones()).sum::<u32>();
            if cost >= limit {
                break;
            }
        }
        cost
    }

    /// Returns the best vector found. `searches` counts the exhaustive searches that are left.
    pub(super) fn best(&self, candidates: impl IntoIterator<Item = Vector>, searches: &mut u32) -> Vector {
        let mut best = (self.cost(self.predicted, u32::MAX), self.predicted);
        let take = |best: &mut (u32, Vector), vector: Vector| {
            let cost = self.cost(vector, best.0);
            let better = cost < best.0;
            if better {
                *best = (cost, vector);
            }
            better
        };
        for candidate in candidates {
            if best.0 <= OWN_COST {
                return best.1;
            }
            if candidate != best.1 {
                take(&mut best, candidate);
            }
        }
        let limit = FAR_COST * u32::try_from(self.own.len()).unwrap_or(1);
        let far = best.0 > limit;
        for step in if far { [16, 4, 1].as_slice() } else { [1].as_slice() } {
            // Every step lowers the cost, so the loop ends; 8 steps suffice for what the coarser step left.
            for _ in 0..8 {
                if best.0 <= OWN_COST {
                    return best.1;
                }
                let from = best.1;
                let around = [(-1, 0), (1, 0), (0, -1), (0, 1)].map(|(x, y)| from.plus(x * step, y * step));
                let mut better = false;
                for vector in around.into_iter().flatten() {
                    better |= take(&mut best, vector);
                }
                if !better {
                    break;
                }
            }
        }
        // The places around start from the vector found here.
        if best.0 > limit && *searches > 0 {
            *searches -= 1;
            for (x, y) in (-FAR_PX[1]..=FAR_PX[1]).flat_map(|y| (-FAR_PX[0]..=FAR_PX[0]).map(move |x| (x, y))) {
                if let Some(vector) = self.predicted.plus(x, y) {
                    take(&mut best, vector);
                }
            }
        }
        best.1
    }
}

const _: () = assert!(MAX_MOTION_PX < 1 << 9);

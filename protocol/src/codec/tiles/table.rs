//! Tables of adaptive models that return to the prior at each slice without copying all of it.
//!
//! A slice uses a tenth of the contexts, so each is reset when the slice first uses it.

/// A state, and the slice that last reset it.
#[derive(Debug, Clone, Copy)]
struct Slot<S> {
    state: S,
    slice: u8,
}

/// Models of one kind, one for each context.
#[derive(Debug)]
pub(super) struct Table<S: 'static, const CONTEXTS: usize> {
    slots: Box<[Slot<S>; CONTEXTS]>,
    slice: u8,
    prior: Option<&'static [S; CONTEXTS]>,
}

impl<S: Copy, const CONTEXTS: usize> Table<S, CONTEXTS> {
    /// Begins every slice with `prior`.
    pub(super) fn new(prior: &'static [S; CONTEXTS]) -> Self {
        Self { slots: Box::new(prior.map(|state| Slot { state, slice: 0 })), slice: 0, prior: Some(prior) }
    }

    /// Begins with `blank` and is never reset: for counting.
    pub(super) fn blank(blank: S) -> Self {
        Self { slots: Box::new([Slot { state: blank, slice: 0 }; CONTEXTS]), slice: 0, prior: None }
    }

    pub(super) fn begin(&mut self) {
        self.slice = self.slice.wrapping_add(1);
        if self.slice == 0 {
            // Slots may still have this number from 256 slices ago.
            self.slots.iter_mut().for_each(|slot| slot.slice = 0);
            self.slice = 1;
        }
    }

    #[inline(always)]
    pub(super) fn at(&mut self, context: usize) -> &mut S {
        let slot = &mut self.slots[context];
        if slot.slice != self.slice
            && let Some(prior) = self.prior
        {
            *slot = Slot { state: prior[context], slice: self.slice };
        }
        &mut slot.state
    }

    pub(super) fn all(&self) -> impl Iterator<Item = &S> {
        self.slots.iter().map(|slot| &slot.state)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_slice_begins_with_the_prior() {
        let mut table = Table::new(&[1_u32, 2, 3]);
        for slice in 0..1000 {
            table.begin();
            let context = slice % 3;
            assert_eq!(*table.at(context), [1, 2, 3][context]);
            *table.at(context) += 7;
            assert_eq!(*table.at(context), [8, 9, 10][context]);
        }
    }
}

//! Looks at some scans: whether they show the landmarks that should be in view.

use super::EkfSlam;
use crate::diagnosis::looks::{InView, MapInView};
use crate::diagnosis::Returns;
use crate::filter::Identities;
use crate::measurement::Placing;

/// A landmark seen less often than this may be clutter, of which nobody expects to see it again.
const SIGHTINGS_TO_COUNT: u32 = 3;

impl<M: Placing> EkfSlam<M> {
    /// Counts the landmarks that the scan should have shown, and those that it did; `None` where it says nothing new.
    pub(super) fn look_at_map(&mut self) -> Option<MapInView> {
        if self.identities == Identities::All || !self.state.watch.examines() {
            return None;
        }
        let (pose, view) = (self.state.pose, self.state.watch.view());
        if !self.state.watch.looks_from(pose) {
            return None;
        }
        let (outlook, mut in_view) = (view.from(pose), MapInView::default());
        for index in self.counted() {
            if outlook.contains(self.landmark_mean(index)) {
                let birth = u64::from(index);
                let sighted = self.state.watch.has_matched(birth);
                self.state.watch.looked(&mut in_view, InView { birth, sighted });
            }
        }
        Some(in_view)
    }

    /// Landmarks that are no clutter.
    fn counted(&self) -> Vec<u32> {
        let landmarks = (0_u32..).zip(&self.state.landmarks);
        landmarks.filter(|(_, l)| l.sightings >= SIGHTINGS_TO_COUNT && !l.is_given_up).map(|(index, _)| index).collect()
    }

    /// What came of the returns to the landmarks that are no clutter.
    pub fn returns(&self) -> Returns {
        self.state.watch.returns(self.counted().into_iter().map(u64::from))
    }
}

//! What the best particle took the sightings of the last scan for, for whoever watches.

use super::scan::ScanSighting;
use super::FastSlam;
use crate::association::{CandidateTable, Decision};
use crate::measurement::MeasurementModel;
use crate::sighting::{Seen, Taken};

impl<M: MeasurementModel> FastSlam<M> {
    /// What the best particle took the usable sightings of the last scan for.
    pub fn seen(&self) -> &[Seen] {
        &self.work.seen
    }

    /// Takes note of a scan whose sightings all name their landmark; those born since then are new.
    pub(super) fn see_identified(&mut self, rounds: &[Vec<ScanSighting>], births_before: u64) {
        let mut seen = std::mem::take(&mut self.work.seen);
        seen.extend(rounds.iter().flatten().map(|sighting| {
            let birth = self.known_slot(sighting).map(|slot| self.state.landmarks.birth(slot));
            let taken = match birth {
                Some(birth) if birth < births_before => Taken::Landmark(birth),
                Some(birth) => Taken::New(birth),
                None => Taken::Nothing,
            };
            Seen { value: sighting.measured.value, taken }
        }));
        self.work.seen = seen;
    }

    /// Takes note of what was decided; sightings taken for new landmarks made those of `births`.
    pub(super) fn see_decided(
        &mut self,
        scan: &[ScanSighting],
        decisions: &[Decision],
        table: &CandidateTable,
        births: &[u64],
    ) {
        let best = self.state.particles.best();
        let landmarks = &self.state.landmarks;
        let made = decisions[best * scan.len()..][..scan.len()].iter().zip(births);
        self.work.seen.extend(scan.iter().zip(made).map(|(sighting, (decision, born))| {
            let taken = match decision {
                Decision::Landmark(candidate) => Taken::Landmark(landmarks.birth(table.slots[*candidate as usize])),
                Decision::New => Taken::New(*born),
                Decision::Ignored => Taken::Nothing,
            };
            Seen { value: sighting.measured.value, taken }
        }));
    }
}

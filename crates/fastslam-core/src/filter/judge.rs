//! What a scan says of landmarks beside their places: whether they exist, and whether two are one.

use super::looking::fade_unconfirmed;
use super::merging::{is_due, Unions};
use super::setup::Setup;
use super::state::State;
use super::work::Work;
use super::{existence, StepInfo};
use crate::association::{Identities, MergingRule, ScanSighting};
use crate::measurement::Placing;

/// Counts a scan for and against the landmarks in view, and makes one of those that are. Where sightings name their
/// landmarks there is nothing to judge.
///
/// **Source:** `montemerlo2003fastslam`, eq. 22.
pub(super) fn judge<M: Placing>(
    setup: &Setup<M>,
    state: &mut State,
    work: &mut Work,
    scan: &[ScanSighting],
    info: &mut StepInfo,
) {
    if setup.settings.identities == Identities::All || scan.is_empty() {
        return;
    }
    let (claims, first_birth) = (work.associating.claims(scan), work.correcting.first_birth);
    info.changes.removed += fade_unconfirmed(setup, state, claims, first_birth, &mut work.judging);
    if existence::is_judged(&setup.settings, &state.landmarks) {
        let maps = state.maps();
        info.changes.removed += existence::judge(&setup.settings, maps, claims, &work.correcting, &mut work.judging);
    }
    if setup.settings.config.association.merging.rule != MergingRule::Never {
        let step = state.counters.steps;
        let mut unions = Unions::of(&setup.settings, state);
        unions.note_sighted_together(claims, &work.correcting.founded);
        if is_due(step) {
            info.changes.merged += unions.merge_near(claims, &work.correcting);
        }
    }
}

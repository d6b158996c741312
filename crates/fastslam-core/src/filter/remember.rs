//! What is kept of a scan: for draws of whole paths, for a given map, for whoever watches.

use super::beginning::{count_given_decided, count_given_named};
use super::doubts::note_need;
use super::errors::Shown;
use super::examine::completed;
use super::setup::Setup;
use super::state::State;
use super::work::{Claims, Work};
use crate::association::{Decision, Identities, ScanSighting};
use crate::measurement::Placing;
use crate::sighting::{Seen, Taken};
use crate::smoothing::NO_LANDMARK;

/// Remembers a scan with what it was taken for.
pub(super) fn remember<M: Placing>(setup: &Setup<M>, state: &mut State, work: &mut Work, scan: &[ScanSighting]) {
    if setup.settings.identities == Identities::All {
        count_given_named(setup, state, scan, &work.associating.named);
        remember_named(state, scan, &work.associating.named);
        let named = scan.iter().zip(&work.associating.named);
        work.imagining.shown.extend(named.filter_map(|(sighting, slot)| Some(((*slot)?, sighting.measured))));
        return;
    }
    let (claims, births) = (work.associating.claims(scan), &work.correcting.births);
    remember_decided(state, claims, births);
    see_decided(setup, state, (claims, births), &mut work.seen);
    show_decided(state, claims, &work.correcting.founded, &mut work.imagining.shown);
    remember_need(setup, state, claims, &work.correcting.founded);
    count_given_decided(setup, state, claims);
}

/// Remembers a scan whose sightings belong to the same landmarks in all maps.
fn remember_named(state: &mut State, scan: &[ScanSighting], named: &[Option<u32>]) {
    let Some(rejuvenation) = &mut state.rejuvenation else { return };
    let birth = |slot: &Option<u32>| slot.map_or(NO_LANDMARK, |slot| state.landmarks.birth(slot) as u32);
    let births: Vec<u32> = named.iter().map(birth).collect();
    rejuvenation.history.explained_alike(scan.iter().map(|s| s.measured), &births);
    let Some(need) = &mut rejuvenation.need else { return };
    need.scanned(scan.len(), state.particles.len());
    for slot in named.iter().flatten() {
        need.sighted(state.given.clan(state.landmarks.birth(*slot)) as u32);
    }
}

/// Remembers a scan with every particle's decisions; sightings taken for new landmarks made those of `births`.
fn remember_decided(state: &mut State, claims: Claims<'_>, births: &[u64]) {
    let Some(rejuvenation) = &mut state.rejuvenation else { return };
    let old: Vec<u32> = claims.table.slots.iter().map(|slot| state.landmarks.birth(*slot) as u32).collect();
    let choice = |particle: usize, j: usize| match claims.of(particle)[j] {
        Decision::Landmark(candidate) => old[candidate as usize],
        Decision::New => births[j] as u32,
        Decision::Ignored => NO_LANDMARK,
    };
    rejuvenation.history.explained(claims.scan.iter().map(|s| s.measured), choice);
}

/// Where paths are drawn by need, remembers what the best particle sighted and founded.
fn remember_need<M: Placing>(setup: &Setup<M>, state: &mut State, claims: Claims<'_>, founded: &[(usize, u32)]) {
    if state.rejuvenation.as_ref().is_none_or(|rejuvenation| rejuvenation.need.is_none()) {
        return;
    }
    let (mut matched, mut new) = (Vec::new(), Vec::new());
    for (j, decision) in claims.of(state.particles.best()).iter().enumerate() {
        match decision {
            Decision::Landmark(candidate) => matched.push(claims.table.slots[*candidate as usize]),
            Decision::New => new.extend(founded.iter().filter(|(of, _)| *of == j).map(|(_, slot)| *slot)),
            Decision::Ignored => {}
        }
    }
    note_need(setup, state, claims.scan, &matched, &new);
}

/// Takes note of what the best particle decided.
fn show_decided(state: &State, claims: Claims<'_>, founded: &[(usize, u32)], shown: &mut Vec<Shown>) {
    for (j, decision) in claims.of(state.particles.best()).iter().enumerate() {
        let slot = match decision {
            Decision::Landmark(candidate) => Some(claims.table.slots[*candidate as usize]),
            Decision::New => founded.iter().find(|(of, _)| *of == j).map(|(_, slot)| *slot),
            Decision::Ignored => None,
        };
        shown.extend(slot.map(|slot| (slot, claims.scan[j].measured)));
    }
}

/// Takes note, for whoever watches, of what the best particle decided.
fn see_decided<M: Placing>(
    setup: &Setup<M>,
    state: &State,
    (claims, births): (Claims<'_>, &[u64]),
    seen: &mut Vec<Seen>,
) {
    let made = claims.of(state.particles.best()).iter().zip(births);
    seen.extend(claims.scan.iter().zip(made).map(|(sighting, (decision, born))| {
        let value = sighting.measured.value;
        match decision {
            Decision::Landmark(candidate) => {
                let slot = claims.table.slots[*candidate as usize];
                let taken = Taken::Landmark(state.landmarks.birth(slot));
                Seen { value: completed(setup, state, slot, value), taken }
            }
            Decision::New => Seen { value, taken: Taken::New(*born) },
            Decision::Ignored => Seen { value, taken: Taken::Nothing },
        }
    }));
}

/// Takes note, for whoever watches, of scans whose sightings all name their landmark; those born since then are new.
pub(super) fn see_named<M: Placing>(
    setup: &Setup<M>,
    state: &State,
    (rounds, births_before): (&[Vec<ScanSighting>], u64),
    seen: &mut Vec<Seen>,
) {
    seen.extend(rounds.iter().flatten().map(|sighting| {
        let slot = state.landmarks.named(sighting);
        let value = sighting.measured.value;
        let value = slot.map_or(value, |slot| completed(setup, state, slot, value));
        let birth = slot.map(|slot| state.landmarks.birth(slot));
        let taken = match birth {
            Some(birth) if birth < births_before => Taken::Landmark(birth),
            Some(birth) => Taken::New(birth),
            None => Taken::Nothing,
        };
        Seen { value, taken }
    }));
}

//! The likeliest explanation of one sighting, and the order in which the sightings of a scan are decided.

use super::hypothesis::Hypothesis;
use super::rules::Rules;
use super::settings::AssociationOrder;
use super::table::Decision;
use crate::density::Fit;
use crate::sighting::ScanSighting;

/// What deciding about a scan needs to remember; kept from particle to particle.
#[derive(Clone, Debug, Default)]
pub struct Scratch {
    pub(super) used: Vec<u32>,
    pub(super) order: Vec<usize>,
    pub(super) margins: Vec<f64>,
    pub(super) weights: Vec<f64>,
    /// Log-likelihoods of the candidates of a sighting, where they are explanations.
    pub(super) fits: Vec<Option<f64>>,
}

/// A scan, and for each of its sightings the candidates: landmarks that it may show.
#[derive(Clone, Copy, Debug)]
pub struct Candidates<'a> {
    /// What was seen.
    pub scan: &'a [ScanSighting],
    /// Numbers of candidates by sighting.
    pub of_sighting: &'a [Vec<u32>],
}

/// The best explanation of a sighting that is still undecided.
#[derive(Clone, Copy)]
pub(super) struct Choice {
    pub(super) best: Option<(u32, Fit)>,
    /// By how much (in log-likelihood) it is better than the next explanation.
    pub(super) margin: f64,
    /// Somebody says so: believed wherever the landmark lies.
    pub(super) certain: bool,
}

impl Choice {
    /// What maximum likelihood makes of it, with the log-likelihood of that.
    pub(super) fn decision(&self, rules: &Rules) -> (Decision, f64) {
        match self.best {
            Some((candidate, fit)) if self.certain => (Decision::Landmark(candidate), fit.log_likelihood),
            Some((candidate, fit)) if fit.log_likelihood >= rules.log_new_density => {
                let explains = fit.log_likelihood >= rules.log_unexplained_density;
                if explains && fit.mahalanobis_squared <= rules.gate && self.margin >= rules.least_lead {
                    (Decision::Landmark(candidate), fit.log_likelihood)
                } else {
                    (Decision::Ignored, rules.log_unexplained_density)
                }
            }
            _ => (Decision::New, rules.log_unexplained_density),
        }
    }
}

/// The order in which one hypothesis decides about the sightings: those with an identity first, then the rest as they
/// come or the least ambiguous first.
///
/// **Why:** a sure sighting refines the pose, and the smaller uncertainty then decides the doubtful ones. The order is
/// that of the belief before the scan; judging it anew after every decision costs the square of the sightings and gains
/// nothing that the logs show.
pub(super) fn order_decisions<H: Hypothesis>(
    rules: &Rules,
    among: Candidates<'_>,
    hypothesis: &H,
    scratch: &mut Scratch,
) {
    let scan = among.scan;
    let Scratch { order, margins, .. } = scratch;
    order.clear();
    order.extend(0..scan.len());
    let is_open = scan.len() > 1 && rules.order == AssociationOrder::LeastAmbiguousFirst;
    if is_open && !hypothesis.pose_is_certain() {
        let margin = |j: &usize| best_choice(rules, among, *j, hypothesis, &[]).margin;
        margins.clear();
        margins.extend(order.iter().map(margin));
        order.sort_by(|a, b| margins[*b].total_cmp(&margins[*a]));
    }
    if scan.iter().any(|sighting| sighting.identity.is_some()) {
        order.sort_by_key(|j| scan[*j].identity.is_none());
    }
}

/// The likeliest landmark of the sighting `index` under one hypothesis. Ties go to the older landmark.
pub(super) fn best_choice<H: Hypothesis>(
    rules: &Rules,
    among: Candidates<'_>,
    index: usize,
    hypothesis: &H,
    used: &[u32],
) -> Choice {
    let (sighting, candidates) = (&among.scan[index], &among.of_sighting[index]);
    let wanted = sighting.identity.map(|identity| f64::from(identity) + 1.0);
    let mut best: Option<(u32, Fit)> = None;
    let mut second = rules.log_unexplained_density;
    for (place, &candidate) in candidates.iter().enumerate() {
        if used.contains(&candidate) {
            continue;
        }
        let Some(fit) = hypothesis.fit([index, place], candidate, &sighting.measured) else { continue };
        if let Some(wanted) = wanted {
            let mark = hypothesis.identity_mark(candidate);
            if mark == wanted {
                return Choice { best: Some((candidate, fit)), margin: f64::INFINITY, certain: true };
            }
            if mark != 0.0 {
                continue;
            }
        }
        match best {
            Some((_, leader)) if fit.log_likelihood <= leader.log_likelihood => {
                second = second.max(fit.log_likelihood);
            }
            leader => {
                second = leader.map_or(second, |(_, l)| second.max(l.log_likelihood));
                best = Some((candidate, fit));
            }
        }
    }
    Choice { best, margin: margin(rules, best.map(|(_, fit)| fit.log_likelihood), second), certain: false }
}

/// By how much the best explanation is better than the second: what the map lacks counts as less certain than any
/// landmark, and as the more certain the farther the nearest landmark lies.
fn margin(rules: &Rules, best: Option<f64>, second: f64) -> f64 {
    let margin = match best {
        Some(log_likelihood) if log_likelihood >= rules.log_unexplained_density => log_likelihood - second,
        Some(log_likelihood) => rules.log_unexplained_density - log_likelihood - 1e6,
        None => -1e3,
    };
    ordered(margin)
}

/// A margin that sorts: what is no number comes last, for its sign is up to the processor.
#[inline(always)]
pub(in crate::association) fn ordered(margin: f64) -> f64 {
    if margin.is_nan() {
        f64::NEG_INFINITY
    } else {
        margin
    }
}

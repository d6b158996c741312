//! How well particles explain a scan.

use super::setup::Setup;
use super::state::State;
use super::work::Work;
use super::StepInfo;
use crate::association::Identities;
use crate::error::Result;

/// Forgets the likelihoods of the scan before.
pub(super) fn clear_log_likelihood(state: &State, work: &mut Work) {
    work.log_likelihood.clear();
    work.log_likelihood.resize(state.particles.len(), 0.0);
}

/// Multiplies the weights by the likelihoods of the scan, and normalises them.
///
/// What particles decide is tempered already; what names say is not.
///
/// **Source:** `montemerlo2002fastslam`, section 3.2; `montemerlo2003fastslam`, eq. 19.
pub(super) fn weigh<M>(setup: &Setup<M>, state: &mut State, log_likelihood: &[f64], info: &mut StepInfo) -> Result<()> {
    let exponent = match setup.settings.identities {
        Identities::All => setup.settings.rules.likelihood_exponent,
        _ => 1.0,
    };
    for (i, log_likelihood) in log_likelihood.iter().enumerate() {
        state.particles.log_weight[i] += exponent * log_likelihood;
        state.particles.score[i] += exponent * log_likelihood;
    }
    normalize(state, info)
}

/// Normalises the weights; what their sum has gained is evidence for the configuration.
pub(super) fn normalize(state: &mut State, info: &mut StepInfo) -> Result<()> {
    info.weighing.log_likelihood += state.weights.renormalize(&state.particles.log_weight, state.counters.steps)?;
    info.weighing.effective_sample_size = state.weights.effective_sample_size;
    Ok(())
}

//! The rules of association with their thresholds worked out.

use super::settings::{AssociationOrder, Exclusion, Method};
use crate::config::Config;
use crate::density::{chi_squared, chi_squared_of, chi_squared_of_pairs, Tail, LN_TAU};
use crate::geometry::Symmetric2;
use crate::math;
use crate::measurement::Placing;

/// Scans with more ambiguous sightings than this are decided one by one.
pub const MOST_JOINT: usize = 15;

/// The lead of nine to one, by which a sighting of one number is taken for a landmark.
///
/// **Why:** in a direction, or at a distance, several landmarks lie. A sensor of two numbers would found a new one in doubt;
/// what one of these is left out of tells little, and what is taken for the wrong one bends path and map.
const SURE_LEAD: f64 = 2.2;

/// The squared joint distance that so many pairs (two dimensions each) exceed with one minus `probability`.
pub fn joint_gates(probability: f64) -> [f64; MOST_JOINT + 1] {
    std::array::from_fn(|n| chi_squared_of_pairs(n, probability))
}

/// How many numbers a sighting has.
fn numbers_of<M: Placing>(model: &M) -> usize {
    model.measures().into_iter().filter(|measured| *measured).count()
}

/// ln of the density at the outer gate of a landmark as uncertain as one sighting.
fn log_outer_density<M: Placing>(config: &Config, model: &M) -> f64 {
    let outer = chi_squared(numbers_of(model), config.association.new_landmark_gate_probability);
    let excess = model.tail(config.sensor.tail()).log_excess(outer);
    let noise = model.noise_covariance();
    let twice = match model.measures() {
        [true, true] => noise.scaled(2.0),
        [true, false] => Symmetric2 { xx: 2.0 * noise.xx, ..noise },
        [false, _] => Symmetric2 { yy: 2.0 * noise.yy, ..noise },
    };
    -0.5 * (outer + math::ln(twice.determinant())) - LN_TAU + excess
}

/// The rules of association with their thresholds worked out.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rules {
    /// How one explanation is chosen.
    pub method: Method,
    /// A sighting belongs to its likeliest landmark when the squared Mahalanobis distance is at most this.
    pub gate: f64,
    /// By so much (in log-likelihood) its likeliest landmark must lead, or the sighting shows nothing that is known.
    pub least_lead: f64,
    /// ln of the density below which a sighting is a new landmark.
    pub log_new_density: f64,
    /// ln of the density of what no landmark explains: that of new landmarks and clutter together.
    pub log_unexplained_density: f64,
    /// Density of false sightings, where it is told.
    pub clutter_density: Option<f64>,
    /// The log-odds that a new landmark exists, where the densities of both are told.
    pub initial_log_odds: Option<f64>,
    /// ln of the most by which anything but the place can raise a likelihood.
    pub log_most_evidence: f64,
    /// The squared joint distance at which so many pairs together are still accepted.
    pub joint_gates: [f64; MOST_JOINT + 1],
    /// What one landmark may explain.
    pub exclusion: Exclusion,
    /// Order of the decisions.
    pub order: AssociationOrder,
    /// Power of the likelihood in the weight.
    pub likelihood_exponent: f64,
}

impl Rules {
    /// The configured rules for a sensor.
    pub fn new<M: Placing>(config: &Config, model: &M) -> Self {
        let association = &config.association;
        // What is told by both numbers, by those that the sensor measures.
        let told = |density: f64| density * model.unmeasured_extent();
        let log_new_density = association
            .new_landmark_density
            .map_or_else(|| log_outer_density(config, model), |new| math::ln(told(new)));
        let density = math::exp(log_new_density);
        Self {
            method: association.method,
            gate: chi_squared(numbers_of(model), association.gate_probability),
            least_lead: if model.places() { f64::NEG_INFINITY } else { SURE_LEAD },
            log_new_density,
            log_unexplained_density: association
                .clutter_density
                .map_or(log_new_density, |clutter| math::ln(density + told(clutter))),
            clutter_density: association.clutter_density.map(told),
            initial_log_odds: association
                .clutter_density
                .zip(association.new_landmark_density)
                .map(|(clutter, new)| math::ln(new / clutter)),
            log_most_evidence: association.log_most_evidence(),
            joint_gates: if model.places() {
                joint_gates(association.gate_probability)
            } else {
                std::array::from_fn(|n| chi_squared_of(n, association.gate_probability))
            },
            exclusion: association.exclusion,
            order: association.order,
            likelihood_exponent: config.filter.likelihood_exponent,
        }
    }

    /// How many standard deviations a landmark can lie off and still be likelier than a new one: its likelihood is at
    /// most that with the sensor's noise alone.
    pub fn gate_radius<M: Placing>(&self, model: &M, tail: Tail) -> f64 {
        let peak = -0.5 * math::ln(model.noise_covariance().determinant()) - LN_TAU;
        tail.reach(peak + self.log_most_evidence - self.log_new_density)
    }
}

//! What landmarks look like: the probabilities of their classes and their signatures, per particle.
//!
//! Kept apart from the Gaussians, like existence, so that logs without appearance pay nothing. A landmark that the log
//! said nothing about is as likely to be of any class, and its signature is anywhere in the range of signatures.

use crate::association::Appearance;
use crate::config::{AssociationConfig, Classes, Signatures};
use crate::density::LN_TAU;
use crate::math;
use crate::store::{LandmarkStore, Rows, RowsMut, StoreKind, StoreUsage};
use serde::{Deserialize, Serialize};

/// Columns: whether the row counts; the signature's mean, and its variance (0 before the first measurement); then the
/// probability of every class.
const MEAN: usize = 1;
const VARIANCE: usize = 2;
const FIRST_CLASS: usize = 3;

/// The appearance of the landmarks of all maps.
#[derive(Clone, Serialize, Deserialize)]
pub struct Appearances {
    store: Box<dyn LandmarkStore>,
    classes: Option<Classes>,
    signatures: Option<Signatures>,
    columns: usize,
}

impl Appearances {
    /// Nothing is known of any landmark; `None` when no appearance is configured.
    pub fn new(kind: StoreKind, particles: usize, config: &AssociationConfig) -> Option<Self> {
        let (classes, signatures) = (config.classes.clone(), config.signatures.clone());
        if classes.is_none() && signatures.is_none() {
            return None;
        }
        let columns = FIRST_CLASS + classes.as_ref().map_or(0, |c| c.number as usize);
        Some(Self { store: kind.create(particles, columns), classes, signatures, columns })
    }

    /// The part of an appearance that is configured and makes sense.
    fn heeded(&self, appearance: Appearance) -> Appearance {
        let number = self.classes.as_ref().map_or(0, |classes| classes.number);
        Appearance {
            class: appearance.class.filter(|class| *class < number),
            signature: appearance.signature.filter(|value| self.signatures.is_some() && value.is_finite()),
        }
    }

    /// Adds a landmark that nothing is known of, in all maps.
    pub fn insert(&mut self, slot: u32) {
        let rows = self.unknown(self.store.particle_count());
        self.store.insert(slot, &rows);
    }

    /// Adds a landmark of a given map, which looks alike in all maps: one row.
    pub fn adopt(&mut self, slot: u32, appearance: Appearance) {
        let mut row = self.unknown(1);
        let known = self.heeded(appearance);
        take_over(&mut RowsMut::new(&mut row, 1), 0, (&self.classes, &self.signatures), known);
        self.store.insert_shared(slot, &row);
    }

    /// Rows of so many particles of which nothing is known, column after column.
    fn unknown(&self, n: usize) -> Vec<f64> {
        let chance = self.classes.as_ref().map_or(0.0, |classes| 1.0 / f64::from(classes.number));
        let mut rows = vec![0.0; self.columns * n];
        rows[..n].fill(1.0);
        rows[FIRST_CLASS * n..].fill(chance);
        rows
    }

    /// Takes a landmark out of all maps.
    pub fn remove(&mut self, slot: u32) {
        self.store.remove(slot);
    }

    /// Map i becomes a copy of the former map `ancestor_indices[i]`.
    pub fn resample(&mut self, ancestor_indices: &[u32]) {
        self.store.resample(ancestor_indices);
    }

    /// What the rows occupy.
    pub fn usage(&self) -> StoreUsage {
        self.store.usage()
    }

    /// Adds to every particle's number how much likelier a sighting's appearance is of this landmark than of any other:
    /// ln Σ_c p(reported | c) p(c) · C, and ln N(signature; mean, variance + σ²) · spread.
    pub fn add_evidence(&mut self, slot: u32, appearance: Appearance, evidence: &mut [f64]) {
        let Appearance { class, signature } = self.heeded(appearance);
        let Self { store, classes, signatures, .. } = self;
        let rows = store.read(slot);
        if let (Some(classes), Some(class)) = (classes, class) {
            for (i, value) in evidence.iter_mut().enumerate() {
                let known = |c: u32| rows.column(FIRST_CLASS + c as usize)[i];
                let likelihood: f64 = (0..classes.number).map(|c| classes.confusion(class, c) * known(c)).sum();
                *value += math::ln(likelihood * f64::from(classes.number));
            }
        }
        if let (Some(signatures), Some(signature)) = (signatures, signature) {
            let (means, variances) = (rows.column(MEAN), rows.column(VARIANCE));
            for (i, value) in evidence.iter_mut().enumerate().filter(|(i, _)| variances[*i] != 0.0) {
                let variance = variances[i] + signatures.std * signatures.std;
                let off = signature - means[i];
                *value += math::ln(signatures.spread) - 0.5 * (off * off / variance + math::ln(variance) + LN_TAU);
            }
        }
    }

    /// How much likelier two landmarks of one map look as they do if they are one thing than if they are two:
    /// ln Σ_c p(c) q(c) · C, and ln N(difference of the signatures) · spread.
    pub fn evidence_of_one(&self, slots: [u32; 2], particle: usize) -> f64 {
        let mut rows = [vec![0.0; self.columns], vec![0.0; self.columns]];
        let held = slots.iter().zip(&mut rows).all(|(slot, row)| self.store.read_row(*slot, particle, row));
        if !held {
            return 0.0;
        }
        let [a, b] = &rows;
        let mut evidence = 0.0;
        if let Some(classes) = &self.classes {
            let alike: f64 = a[FIRST_CLASS..].iter().zip(&b[FIRST_CLASS..]).map(|(p, q)| p * q).sum();
            evidence += math::ln(alike * f64::from(classes.number));
        }
        if let Some(signatures) = self.signatures.as_ref().filter(|_| a[VARIANCE] != 0.0 && b[VARIANCE] != 0.0) {
            let (off, variance) = (a[MEAN] - b[MEAN], a[VARIANCE] + b[VARIANCE]);
            evidence += math::ln(signatures.spread) - 0.5 * (off * off / variance + math::ln(variance) + LN_TAU);
        }
        evidence
    }

    /// Takes a sighting's appearance for the landmark's own in the maps that `mask` marks.
    pub fn learn(&mut self, slot: u32, mask: &[bool], appearance: Appearance) {
        let seen = self.heeded(appearance);
        if seen.class.is_none() && seen.signature.is_none() {
            return;
        }
        let Self { store, classes, signatures, .. } = self;
        store.update(slot, Some(mask), &mut |mut rows| {
            (0..mask.len()).filter(|i| mask[*i]).for_each(|i| take_over(&mut rows, i, (classes, signatures), seen));
        });
    }

    /// Puts what is known of landmark `from` into landmark `into`: taken over where `moved`, combined where `fused`.
    pub fn merge(&mut self, from: u32, into: u32, [moved, fused]: [&[bool]; 2]) {
        let n = self.store.particle_count();
        let rows = self.store.read(from);
        let other: Vec<f64> = (0..self.columns).flat_map(|c| rows.column(c).to_vec()).collect();
        let number = self.classes.as_ref().map_or(0, |classes| classes.number);
        let touched: Vec<bool> = (0..n).map(|i| moved[i] || fused[i]).collect();
        self.store.update(into, Some(&touched), &mut |mut rows| {
            let other = Rows::new(&other, n);
            for i in (0..n).filter(|i| touched[*i]) {
                if moved[i] {
                    (0..FIRST_CLASS + number as usize).for_each(|c| rows.column(c)[i] = other.column(c)[i]);
                    continue;
                }
                multiply_classes(&mut rows, i, number, |c| other.column(FIRST_CLASS + c as usize)[i]);
                let [mean, variance] = [other.column(MEAN)[i], other.column(VARIANCE)[i]];
                if variance != 0.0 {
                    fuse_signature(&mut rows, i, [mean, variance]);
                }
            }
        });
    }

    /// The likeliest class and the mean signature over the particles that hold a landmark, `weights` zero elsewhere.
    pub fn estimate(&mut self, slot: u32, weights: &[f64]) -> Appearance {
        let number = self.classes.as_ref().map_or(0, |classes| classes.number);
        let rows = self.store.read(slot);
        let total = |column: usize| weights.iter().zip(rows.column(column)).map(|(w, v)| w * v).sum::<f64>();
        let chance = 1.0 / f64::from(number.max(1));
        let mut class = None;
        let mut highest = weights.iter().sum::<f64>() * chance * (1.0 + 1e-9);
        for c in 0..number {
            let probability = total(FIRST_CLASS + c as usize);
            if probability > highest {
                (class, highest) = (Some(c), probability);
            }
        }
        let (means, variances) = (rows.column(MEAN), rows.column(VARIANCE));
        let (mut mass, mut sum) = (0.0, 0.0);
        for (i, weight) in weights.iter().enumerate().filter(|(i, _)| variances[*i] != 0.0) {
            mass += weight;
            sum += weight * means[i];
        }
        Appearance { class, signature: (mass > 0.0).then(|| sum / mass) }
    }
}

/// Multiplies one map's class probabilities by likelihoods and normalises them.
fn multiply_classes(rows: &mut RowsMut<'_>, i: usize, number: u32, likelihood: impl Fn(u32) -> f64) {
    let mut total = 0.0;
    for c in 0..number {
        let probability = &mut rows.column(FIRST_CLASS + c as usize)[i];
        // A floor keeps a class that was ruled out by mistake possible.
        *probability = (*probability * likelihood(c)).max(1e-12);
        total += *probability;
    }
    (0..number).for_each(|c| rows.column(FIRST_CLASS + c as usize)[i] /= total);
}

/// Takes a sighting's appearance for the landmark's own in one map.
fn take_over(
    rows: &mut RowsMut<'_>,
    i: usize,
    (classes, signatures): (&Option<Classes>, &Option<Signatures>),
    seen: Appearance,
) {
    if let (Some(classes), Some(class)) = (classes, seen.class) {
        multiply_classes(rows, i, classes.number, |c| classes.confusion(class, c));
    }
    if let (Some(signatures), Some(signature)) = (signatures, seen.signature) {
        fuse_signature(rows, i, [signature, signatures.std * signatures.std]);
    }
}

/// Combines one map's signature with another estimate of it.
fn fuse_signature(rows: &mut RowsMut<'_>, i: usize, [mean, variance]: [f64; 2]) {
    let (old_mean, old_variance) = (rows.column(MEAN)[i], rows.column(VARIANCE)[i]);
    let gain = if old_variance == 0.0 { 1.0 } else { old_variance / (old_variance + variance) };
    rows.column(MEAN)[i] = old_mean + gain * (mean - old_mean);
    rows.column(VARIANCE)[i] = gain * variance;
}

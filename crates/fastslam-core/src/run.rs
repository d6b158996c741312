//! A whole log through the filter, in one call.

use crate::config::Config;
use crate::diagnosis::{NoiseReport, TwoPlaces};
use crate::error::Result;
use crate::filter::{Identities, MapEstimate, PoseEstimate, Skipped, StepInfo};
use crate::geometry::Pose;
use crate::slam;
use crate::store::StoreUsage;
use crate::timeline::{Event, LogData, Timeline};

/// Whoever watches a run: it has the clock, and may stop the run.
pub trait Observer {
    /// Seconds since any fixed moment.
    fn now_s(&self) -> f64;
    /// Called after every step with the number of steps done; `false` ends the run early.
    fn step_done(&mut self, done: usize) -> bool;
}

/// What the filter knew after a step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StepRecord {
    /// Seconds.
    pub stamp_s: f64,
    /// Pose with its covariance.
    pub pose: PoseEstimate,
    /// What happened.
    pub info: StepInfo,
    /// Computing time of the step with the motion before it, seconds.
    pub latency_s: f64,
}

/// The outcome of a run.
#[derive(Clone, Debug, Default)]
pub struct RunOutput {
    /// One per step.
    pub steps: Vec<StepRecord>,
    /// Path of the best particle with a pose at every step: stamps in seconds, `T_world_robot`.
    pub smoothed: Vec<(f64, Pose)>,
    /// Landmarks.
    pub map: MapEstimate,
    /// Sightings that could not be used, in total.
    pub skipped: Skipped,
    /// Landmark covariances that lost definiteness and were repaired, in total.
    pub repaired: u64,
    /// What the innovations of the run say of the configured noise.
    pub noise: NoiseReport,
    /// Names that were seen at two places.
    pub two_places: Vec<TwoPlaces>,
    /// What the maps occupy at the end.
    pub usage: StoreUsage,
    /// Computing time of all steps, seconds.
    pub filter_seconds: f64,
    /// Whether the observer ended the run early.
    pub interrupted: bool,
}

/// Runs the configured filter over a log.
///
/// **Errors:** an invalid log or configuration before anything is computed; the step's error when the filter cannot go on.
pub fn run(config: &Config, log: &LogData, observer: &mut dyn Observer) -> Result<RunOutput> {
    log.validate()?;
    log.check_gaps(config.filter.path_period_s)?;
    config.association.check_classes(&log.sightings)?;
    let mut filter = slam::create(config.clone(), identities_in(log))?;
    let timeline = Timeline::new(log, config.motion.timing(), config.filter.path_period_s);
    let mut out = RunOutput::default();
    let mut path_steps: Vec<PathStep> = Vec::new();
    let mut started_s = observer.now_s();
    for event in timeline {
        match event {
            Event::Control(part) => filter.advance(&part)?,
            Event::Step { stamp_s, first, end } => {
                let motion = filter.pending_motion().mean;
                let info = filter.update(stamp_s, &log.sightings[first..end])?;
                path_steps.push(PathStep { stamp_s, motion, sampled: info.sampled });
                let ended_s = observer.now_s();
                out.steps.push(StepRecord { stamp_s, pose: filter.pose(), info, latency_s: ended_s - started_s });
                add(&mut out.skipped, &info.skipped);
                out.repaired += u64::from(info.repaired);
                out.interrupted = !observer.step_done(out.steps.len());
                started_s = observer.now_s();
                if out.interrupted {
                    break;
                }
            }
        }
    }
    let started_s = observer.now_s();
    if !out.interrupted {
        filter.finish();
    }
    let finishing_s = observer.now_s() - started_s;
    out.filter_seconds = out.steps.iter().map(|s| s.latency_s).sum::<f64>() + finishing_s;
    out.smoothed = with_unsampled(&filter.best_path(), &path_steps, config.initial_pose.T_world_robot());
    out.map = filter.map();
    out.usage = filter.usage();
    out.noise = filter.noise_report();
    out.two_places = filter.two_places();
    Ok(out)
}

fn identities_in(log: &LogData) -> Identities {
    let named = log.sightings.iter().filter(|s| s.identity.is_some()).count();
    if named == log.sightings.len() {
        Identities::All
    } else if named == 0 {
        Identities::None
    } else {
        Identities::Some
    }
}

fn add(total: &mut Skipped, step: &Skipped) {
    total.not_finite += step.not_finite;
    total.too_near += step.too_near;
    total.too_far += step.too_far;
    total.without_identity += step.without_identity;
    total.bad_covariance += step.bad_covariance;
}

/// A step as the smoothed path needs it.
struct PathStep {
    stamp_s: f64,
    /// Motion from the last sampled pose to this step, as the odometry has it.
    motion: Pose,
    sampled: bool,
}

/// Puts poses into the stretches in which FastSLAM 2.0 did not sample any.
///
/// Between two sampled poses the path follows the odometry; what the odometry missed is spread evenly over the time.
fn with_unsampled(path: &[(f64, Pose)], steps: &[PathStep], start: Pose) -> Vec<(f64, Pose)> {
    let mut merged = Vec::with_capacity(steps.len());
    let mut nodes = path.iter();
    let mut from = (steps.first().map_or(0.0, |s| s.stamp_s), start);
    let mut gap: Vec<&PathStep> = Vec::new();
    for step in steps {
        if !step.sampled {
            gap.push(step);
            continue;
        }
        let Some(&node) = nodes.next() else { break };
        let missed = from.1.compose(step.motion).inverse().compose(node.1);
        for between in gap.drain(..) {
            let share = (between.stamp_s - from.0) / (node.0 - from.0).max(f64::MIN_POSITIVE);
            merged.push((
                between.stamp_s,
                from.1.compose(between.motion).compose(missed.fraction(share.clamp(0.0, 1.0))),
            ));
        }
        merged.push(node);
        from = node;
    }
    merged.extend(gap.iter().map(|step| (step.stamp_s, from.1.compose(step.motion))));
    merged
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unsampled_stretches_follow_the_odometry_and_share_what_it_missed() {
        let motion = |x: f64| Pose::new(x, 0.0, 0.0);
        let step = |stamp_s: f64, x: f64, sampled| PathStep { stamp_s, motion: motion(x), sampled };
        // Odometry says 4 m in 4 s; the node says 6 m: half a metre is missed every second.
        let steps = [
            step(0.0, 0.0, true),
            step(1.0, 1.0, false),
            step(3.0, 3.0, false),
            step(4.0, 4.0, true),
            step(5.0, 1.0, false),
        ];
        let path = [(0.0, motion(10.0)), (4.0, motion(16.0))];
        let merged = with_unsampled(&path, &steps, Pose::default());
        let x: Vec<f64> = merged.iter().map(|(_, pose)| pose.x).collect();
        for (got, expected) in x.iter().zip([10.0, 11.5, 14.5, 16.0, 17.0]) {
            assert!((got - expected).abs() < 1e-12, "{x:?}");
        }
        assert_eq!(x.len(), 5);
    }
}

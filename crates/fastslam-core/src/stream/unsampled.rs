//! Poses for the stretches of a path in which FastSLAM 2.0 sampled none.

use crate::geometry::Pose;
use serde::{Deserialize, Serialize};

/// A step as the smoothed path needs it.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub(crate) struct PathStep {
    /// Seconds.
    pub stamp_s: f64,
    /// Motion from the last sampled pose to this step, as the odometry has it.
    pub motion: Pose,
    /// Whether a pose was sampled in this step.
    pub sampled: bool,
}

/// Puts poses into the stretches in which FastSLAM 2.0 did not sample any.
///
/// Between two sampled poses the path follows the odometry; what the odometry missed is spread evenly over the time. Which
/// steps have a pose the path says: a draw beside the filter may have sampled others than the steps said.
pub(super) fn with_unsampled(path: &[(f64, Pose)], steps: &[PathStep], start: Pose) -> Vec<(f64, Pose)> {
    let mut merged = Vec::with_capacity(steps.len());
    let mut nodes = path.iter().peekable();
    let mut from = (steps.first().map_or(0.0, |s| s.stamp_s), start);
    let mut gap: Vec<(f64, Pose)> = Vec::new();
    // What leads from the last pose of the path to where the motions of the steps begin, where these are two.
    let mut before: Option<Pose> = None;
    for step in steps {
        let motion = before.map_or(step.motion, |before| before.compose(step.motion));
        let Some(&node) = nodes.next_if(|node| node.0 == step.stamp_s) else {
            gap.push((step.stamp_s, motion));
            before = if step.sampled { Some(motion) } else { before };
            continue;
        };
        let missed = from.1.compose(motion).inverse().compose(node.1);
        for (stamp_s, motion) in gap.drain(..) {
            let share = (stamp_s - from.0) / (node.0 - from.0).max(f64::MIN_POSITIVE);
            merged.push((stamp_s, from.1.compose(motion).compose(missed.fraction(share.clamp(0.0, 1.0)))));
        }
        merged.push(node);
        from = node;
        before = (!step.sampled).then(|| step.motion.inverse());
    }
    merged.extend(gap.into_iter().map(|(stamp_s, motion)| (stamp_s, from.1.compose(motion))));
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

    #[test]
    fn where_the_path_has_poses_of_other_steps_than_were_sampled_motions_count_from_these() {
        let motion = |x: f64| Pose::new(x, 0.0, 0.0);
        let step = |stamp_s: f64, x: f64, sampled| PathStep { stamp_s, motion: motion(x), sampled };
        // A metre a second; the motions begin at 0 s, and from 2 s on there.
        let steps = [
            step(0.0, 0.0, true),
            step(1.0, 1.0, false),
            step(2.0, 2.0, true),
            step(3.0, 1.0, false),
            step(4.0, 2.0, false),
        ];
        for path in [[0.0, 1.0], [0.0, 2.0], [0.0, 3.0], [0.0, 4.0]] {
            let merged = with_unsampled(&path.map(|x| (x, motion(x))), &steps, Pose::default());
            assert_eq!(merged, steps.map(|step| (step.stamp_s, motion(step.stamp_s))), "{path:?}");
        }
    }
}

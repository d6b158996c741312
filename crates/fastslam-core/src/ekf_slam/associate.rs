//! Steps in which the filter decides which landmark a sighting shows.

use super::{EkfSlam, Eye};
use crate::association::{decide, Candidates, Decision, Hypothesis, ScanSighting, Scratch};
use crate::error::Result;
use crate::filter::StepInfo;
use crate::landmark::{fit_with_tail, Fit, Measured};
use crate::measurement::Placing;

/// The one hypothesis of EKF-SLAM, whose state is refined sighting by sighting.
struct JointHypothesis<'a, M> {
    filter: &'a mut EkfSlam<M>,
    failure: Result<()>,
}

impl<M: Placing> Hypothesis for JointHypothesis<'_, M> {
    fn pose_is_certain(&self) -> bool {
        false
    }

    fn fit(&self, _pair: [usize; 2], candidate: u32, measured: &Measured) -> Option<Fit> {
        let view = self.filter.view(candidate, measured);
        Some(fit_with_tail(view.innovation, view.s, measured.tail))
    }

    fn identity_mark(&self, candidate: u32) -> f64 {
        self.filter.state.landmarks[candidate as usize].identity_mark
    }

    fn accept(&mut self, candidate: u32, sighting: &ScanSighting) {
        if self.failure.is_ok() {
            self.failure = self.filter.correct(candidate, sighting).map(|_| ());
        }
    }
}

impl<M: Placing> EkfSlam<M> {
    /// Associates a scan, corrects the landmarks that it shows, and returns the sightings of new ones.
    pub(super) fn correct_associated<'a>(
        &mut self,
        scan: &'a [ScanSighting],
        info: &mut StepInfo,
    ) -> Result<Vec<&'a ScanSighting>> {
        let of_sighting = self.candidates(scan);
        let rules = self.eye().rules;
        let mut decisions = vec![Decision::Ignored; scan.len()];
        let mut hypothesis = JointHypothesis { filter: self, failure: Ok(()) };
        let among = Candidates { scan, of_sighting: &of_sighting };
        info.weighing.log_likelihood += decide(&rules, among, &mut hypothesis, &mut Scratch::default(), &mut decisions);
        hypothesis.failure?;
        info.left_out.ignored += decisions.iter().filter(|d| **d == Decision::Ignored).count() as u32;
        Ok(scan.iter().zip(&decisions).filter(|(_, d)| **d == Decision::New).map(|(s, _)| s).collect())
    }

    /// The landmarks that each sighting might show: those near enough, and those of its identity.
    ///
    /// **Why:** a linear search is as nothing beside the correction, and traces bound the largest eigenvalues.
    fn candidates(&self, scan: &[ScanSighting]) -> Vec<Vec<u32>> {
        let Eye { model, sensor: of, rules, .. } = self.eye();
        let reach = rules.gate_radius(model, model.tail(of.tail()));
        let sensor = self.state.pose.compose(self.eye().T_robot_sensor);
        let lever_arm_m = self.eye().T_robot_sensor.x.hypot(self.eye().T_robot_sensor.y);
        let pose = self.state.covariance.of_pose();
        let spread_m: Vec<f64> = (0..self.state.landmarks.len() as u32)
            .map(|index| {
                let p = self.landmark_covariance(index);
                (p.xx + p.yy).sqrt()
            })
            .collect();
        let find = |sighting: &ScanSighting| {
            let Measured { value, noise, .. } = sighting.measured;
            let lever_m = self.eye().model.range(value) + lever_arm_m;
            let variance = pose[0][0]
                + pose[1][1]
                + lever_m * lever_m * pose[2][2]
                + self.eye().model.position_variance(value, noise);
            let [x, y] = self.eye().model.inverse(sensor, value);
            let near = |index: u32| {
                if !model.places() {
                    return true;
                }
                let [u, v] = self.landmark_mean(index);
                (u - x).hypot(v - y) <= reach * ((2.0 * variance).sqrt() + spread_m[index as usize])
            };
            let mark = sighting.identity.map(|identity| f64::from(identity) + 1.0);
            (0..self.state.landmarks.len() as u32)
                .filter(|&index| near(index) || mark == Some(self.state.landmarks[index as usize].identity_mark))
                .collect()
        };
        scan.iter().map(find).collect()
    }
}

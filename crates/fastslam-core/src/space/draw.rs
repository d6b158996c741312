//! Particles drawn anew from the posterior over the whole path and map.

use super::graph::Solution;
use super::map::Landmark;
use super::past::Past;
use super::pose::{SpacePose, Twist};
use super::state::of_lane;
use super::track::{self, REMEMBERED};
use super::wide::{Wide, LANES};
use crate::normal::Cholesky;
use crate::random::Stream;
use crate::real::Real;

/// What the particles of a block have drawn.
pub struct Drawn {
    /// Where they are now.
    pub pose: SpacePose<Wide>,
    /// Their landmarks, given the paths that they have drawn.
    pub landmarks: Vec<Landmark<Wide>>,
    /// The end of their paths, as far as a velocity that wanders remembers it.
    tail: Vec<SpacePose<Wide>>,
}

impl Drawn {
    /// The mean velocity of a particle that has drawn this path.
    pub fn velocity(&self, past: &Past, start: SpacePose, lane: usize) -> Twist {
        let tail: Vec<SpacePose> = self.tail.iter().map(|pose| of_lane(pose, lane)).collect();
        let first = past.scans.len() - tail.len();
        let (before, poses) = match first {
            0 => (start, tail.as_slice()),
            _ => (tail[0], &tail[1..]),
        };
        let scans = &past.scans[past.scans.len() - poses.len()..];
        track::along(scans, before, poses).last().copied().unwrap_or_default()
    }
}

/// Draws of path and map for a block of particles, as distances from the mode.
pub fn whole(solution: &Solution, block: usize, stream: Stream) -> Vec<Wide> {
    let variables = solution.precision.column_starts.len() - 1;
    let mut normal = vec![[0.0; LANES]; variables];
    for (pair, rows) in normal.chunks_mut(2).enumerate() {
        for lane in 0..LANES {
            let numbers = stream.normal_pair((block * LANES + lane) as u32, pair as u32);
            rows.iter_mut().zip(numbers).for_each(|(row, number)| row[lane] = number);
        }
    }
    let mut off = vec![Wide::default(); variables];
    solution.factor.draw(&mut normal, |variable, values| off[variable] = Wide(*values));
    off
}

/// A draw of whole paths for a block of particles; of these the newest pose and the landmarks given the path are kept.
///
/// With H the precision, landmark n given the path is N(μ_n − H_nn⁻¹ H_np δ, H_nn⁻¹) for a path that lies δ off the mode.
pub fn draw(solution: &Solution, block: usize, stream: Stream) -> Option<Drawn> {
    let off = whole(solution, block, stream);
    let (poses, node) = (&solution.at.poses, solution.at.node());
    let drawn = |k: usize| poses[k].constant().compose(SpacePose::exp(std::array::from_fn(|i| off[node * k + i])));
    let pose = drawn(poses.len().checked_sub(1)?);
    let remembered = if solution.at.velocities.is_empty() { 0 } else { REMEMBERED + 1 };
    let tail = (poses.len().saturating_sub(remembered)..poses.len()).map(drawn).collect();
    let landmarks = (0..solution.at.landmarks.len()).map(|n| given_path(solution, n, &off)).collect::<Option<_>>()?;
    Some(Drawn { pose, landmarks, tail })
}

fn given_path(solution: &Solution, landmark: usize, off: &[Wide]) -> Option<Landmark<Wide>> {
    let upper = &solution.precision;
    let first = solution.at.first_of(landmark);
    let mut own = [[0.0; 3]; 3];
    let mut pull = [Wide::default(); 3];
    for c in 0..3 {
        let column = upper.column_starts[first + c]..upper.column_starts[first + c + 1];
        let (above, triangle) = (column.start..column.end - c - 1, column.end - c - 1);
        for k in above {
            pull[c] = pull[c] + Wide::constant(upper.values[k]) * off[upper.rows[k]];
        }
        for r in 0..=c {
            own[r][c] = upper.values[triangle + r];
            own[c][r] = own[r][c];
        }
    }
    let covariance = Cholesky::of(&own)?.inverse();
    let number = Wide::constant;
    let mean = std::array::from_fn(|i| {
        let shift = (0..3).fold(Wide::default(), |sum, k| sum + number(covariance[i][k]) * pull[k]);
        number(solution.at.landmarks[landmark][i]) - shift
    });
    let [[xx, xy, xz], [_, yy, yz], [_, _, zz]] = covariance;
    Some(Landmark { mean, covariance: [xx, xy, xz, yy, yz, zz].map(number) })
}

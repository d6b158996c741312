//! Particles drawn anew from the posterior over the whole path and map.

use super::graph::Solution;
use super::map::Landmark;
use super::pose::SpacePose;
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
    let poses = solution.at.poses.len();
    let newest = 6 * poses.checked_sub(1)?;
    let twist = std::array::from_fn(|i| off[newest + i]);
    let pose = solution.at.poses[poses - 1].constant().compose(SpacePose::exp(twist));
    let landmarks = (0..solution.at.landmarks.len()).map(|n| given_path(solution, n, &off)).collect::<Option<_>>()?;
    Some(Drawn { pose, landmarks })
}

fn given_path(solution: &Solution, landmark: usize, off: &[Wide]) -> Option<Landmark<Wide>> {
    let upper = &solution.precision;
    let first = 6 * solution.at.poses.len() + 3 * landmark;
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

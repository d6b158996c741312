//! A planar arena of rocks, posts and walls, and a laser that scans it by casting rays.
//!
//! Rays walk a uniform grid, so the cost of a beam is that of the cells it crosses, not of the number of objects.

use fastslam_core::detect::BeamGeometry;
use fastslam_core::geometry::Pose;
use fastslam_core::math;
use fastslam_core::random::{Purpose, RandomSource, Stream};

/// A round obstacle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rock {
    /// In the world frame.
    pub center_m: [f64; 2],
    /// Of its outline at the height of the laser.
    pub radius_m: f64,
    /// What a beam that hits it reports; above 0 for reflective posts.
    pub intensity: f64,
}

/// A straight wall without thickness.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Wall {
    /// One end in the world frame.
    pub from_m: [f64; 2],
    /// The other end.
    pub to_m: [f64; 2],
}

/// A planar laser and its errors.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Laser {
    /// Number of beams.
    pub beams: usize,
    /// Where they point and how far they reach.
    pub geometry: BeamGeometry,
    /// Standard deviation of a range.
    pub range_std_m: f64,
    /// Probability that a beam reports nothing though it hit something.
    pub dropout_probability: f64,
}

/// One scan with its truth.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ArenaScan {
    /// Infinity where nothing was hit, NaN where the beam dropped out.
    pub ranges_m: Vec<f64>,
    /// 0 where nothing was hit.
    pub intensities: Vec<f64>,
    /// Index of the rock that each beam hit, dropouts included; None for walls and open beams.
    pub rocks: Vec<Option<usize>>,
}

/// Obstacles, indexed by a grid.
#[derive(Clone, Debug)]
pub struct Arena {
    rocks: Vec<Rock>,
    walls: Vec<Wall>,
    corner_m: [f64; 2],
    cell_m: f64,
    shape: [usize; 2],
    /// Objects of cell c: `members[starts[c]..starts[c + 1]]`; rocks first, then walls.
    starts: Vec<usize>,
    members: Vec<usize>,
}

/// Where a ray ends.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Hit {
    distance_m: f64,
    object: usize,
}

impl Arena {
    /// Index the obstacles; `cell_m` is the side of a grid cell, best about the distance between obstacles.
    pub fn new(rocks: Vec<Rock>, walls: Vec<Wall>, cell_m: f64) -> Self {
        let boxes: Vec<[f64; 4]> = rocks.iter().map(rock_box).chain(walls.iter().map(wall_box)).collect();
        let bounds = boxes
            .iter()
            .fold([0.0, 0.0, 0.0, 0.0_f64], |b, x| [b[0].min(x[0]), b[1].min(x[1]), b[2].max(x[2]), b[3].max(x[3])]);
        let corner_m = [bounds[0] - cell_m, bounds[1] - cell_m];
        let shape = [0, 1].map(|k| ((bounds[k + 2] - corner_m[k]) / cell_m) as usize + 2);
        let mut arena = Self { rocks, walls, corner_m, cell_m, shape, starts: Vec::new(), members: Vec::new() };
        let mut cells: Vec<Vec<usize>> = vec![Vec::new(); shape[0] * shape[1]];
        for (object, limits) in boxes.iter().enumerate() {
            let (low, high) = (arena.cell([limits[0], limits[1]]), arena.cell([limits[2], limits[3]]));
            for row in low[1]..=high[1] {
                for column in low[0]..=high[0] {
                    cells[row * shape[0] + column].push(object);
                }
            }
        }
        for cell in cells {
            arena.starts.push(arena.members.len());
            arena.members.extend(cell);
        }
        arena.starts.push(arena.members.len());
        arena
    }

    /// A square arena of `side_m` about the origin with `count` rocks of random size that keep `clearance_m` from each
    /// other, as far as they find room, and from the walls around.
    pub fn random(seed: u64, count: usize, side_m: f64, radius_m: [f64; 2], clearance_m: f64) -> Self {
        let stream = RandomSource::new(seed).stream(Purpose::Simulation, 0);
        let mut rocks: Vec<Rock> = Vec::with_capacity(count);
        let room = 0.5 * side_m - clearance_m - radius_m[1];
        for draw in 0..50 * count as u32 {
            if rocks.len() == count {
                break;
            }
            let [u, v] = stream.uniform_pair(draw, 0);
            let radius = radius_m[0] + (radius_m[1] - radius_m[0]) * stream.uniform(draw, 1);
            let center = [room * (2.0 * u - 1.0), room * (2.0 * v - 1.0)];
            if rocks.iter().all(|r| distance(r.center_m, center) > r.radius_m + radius + clearance_m) {
                rocks.push(Rock { center_m: center, radius_m: radius, intensity: 0.0 });
            }
        }
        let h = 0.5 * side_m;
        let corners = [[-h, -h], [h, -h], [h, h], [-h, h]];
        let walls = (0..4).map(|k| Wall { from_m: corners[k], to_m: corners[(k + 1) % 4] }).collect();
        Self::new(rocks, walls, (side_m / 20.0).max(radius_m[1]))
    }

    /// The rocks, in the order of their indices.
    pub fn rocks(&self) -> &[Rock] {
        &self.rocks
    }

    /// Scan from `T_world_sensor`, the pose at beam 0, while the sensor moves with `twist` (forward and left in m/s,
    /// turn in rad/s, sensor frame). `number` tells the scans of one seed apart.
    pub fn scan(
        &self,
        T_world_sensor: Pose,
        twist: [f64; 3],
        laser: &Laser,
        random: RandomSource,
        number: u64,
    ) -> ArenaScan {
        let stream = random.stream(Purpose::Simulation, number + 1);
        let period = laser.geometry.beam_period_s.unwrap_or(0.0);
        let mut scan = ArenaScan::default();
        for k in 0..laser.beams {
            let time = k as f64 * period;
            let moved = Pose::from_twist(twist[0] * time, twist[1] * time, twist[2] * time);
            let pose = T_world_sensor.compose(moved);
            let angle = pose.heading + laser.geometry.first_angle_rad + k as f64 * laser.geometry.angle_step_rad;
            let (s, c) = math::sin_cos(angle);
            let hit = self.cast([pose.x, pose.y], [c, s], laser.geometry.max_range_m);
            let (range, intensity) = self.echo(hit, laser, stream, k as u32);
            scan.ranges_m.push(range);
            scan.intensities.push(intensity);
            scan.rocks.push(hit.map(|h| h.object).filter(|&object| object < self.rocks.len()));
        }
        scan
    }

    fn echo(&self, hit: Option<Hit>, laser: &Laser, stream: Stream, beam: u32) -> (f64, f64) {
        let Some(hit) = hit else { return (f64::INFINITY, 0.0) };
        if stream.uniform(beam, 0) < laser.dropout_probability {
            return (f64::NAN, 0.0);
        }
        let range = hit.distance_m + laser.range_std_m * stream.normal_pair(beam, 1)[0];
        (range, self.rocks.get(hit.object).map_or(0.0, |rock| rock.intensity))
    }

    /// Range to the first obstacle along a unit vector; None where there is none up to `max_range_m`.
    pub fn range(&self, from_m: [f64; 2], direction: [f64; 2], max_range_m: f64) -> Option<f64> {
        self.cast(from_m, direction, max_range_m).map(|hit| hit.distance_m)
    }

    /// Walks the cells along the ray (Amanatides and Woo, 1987) and stops at the first cell that holds the nearest hit.
    fn cast(&self, from: [f64; 2], direction: [f64; 2], reach_m: f64) -> Option<Hit> {
        let enter = self.enter(from, direction)?;
        let start = [0, 1].map(|k| from[k] + enter * direction[k]);
        let mut cell = self.cell(start);
        let delta = direction.map(|d| if d == 0.0 { f64::INFINITY } else { self.cell_m / d.abs() });
        let mut next = [0, 1].map(|k| {
            let edge = self.corner_m[k] + self.cell_m * (cell[k] + usize::from(direction[k] > 0.0)) as f64;
            if direction[k] == 0.0 {
                f64::INFINITY
            } else {
                (edge - from[k]) / direction[k]
            }
        });
        let mut best: Option<Hit> = None;
        loop {
            let leave = next[0].min(next[1]);
            best = self.nearest(cell, from, direction, best);
            if let Some(hit) = best.filter(|hit| hit.distance_m <= leave) {
                return (hit.distance_m < reach_m).then_some(hit);
            }
            let axis = usize::from(next[1] < next[0]);
            cell[axis] = if direction[axis] > 0.0 { cell[axis] + 1 } else { cell[axis].wrapping_sub(1) };
            next[axis] += delta[axis];
            if leave >= reach_m || cell[axis] >= self.shape[axis] {
                return best.filter(|hit| hit.distance_m < reach_m);
            }
        }
    }

    /// How far along the ray the grid begins: 0 inside of it, None where the ray misses it.
    fn enter(&self, from: [f64; 2], direction: [f64; 2]) -> Option<f64> {
        let (mut low, mut high) = (0.0_f64, f64::INFINITY);
        for k in 0..2 {
            let bounds = [self.corner_m[k], self.corner_m[k] + self.cell_m * self.shape[k] as f64];
            if direction[k] == 0.0 {
                if from[k] < bounds[0] || from[k] > bounds[1] {
                    return None;
                }
            } else {
                let crossings = bounds.map(|b| (b - from[k]) / direction[k]);
                low = low.max(crossings[0].min(crossings[1]));
                high = high.min(crossings[0].max(crossings[1]));
            }
        }
        (low <= high).then_some(low)
    }

    fn cell(&self, point: [f64; 2]) -> [usize; 2] {
        [0, 1].map(|k| {
            let steps = ((point[k] - self.corner_m[k]) / self.cell_m).floor().max(0.0);
            (steps as usize).min(self.shape[k] - 1)
        })
    }

    fn nearest(&self, cell: [usize; 2], from: [f64; 2], direction: [f64; 2], best: Option<Hit>) -> Option<Hit> {
        let c = cell[1] * self.shape[0] + cell[0];
        self.members[self.starts[c]..self.starts[c + 1]].iter().fold(best, |best, &object| {
            let distance = match self.rocks.get(object) {
                Some(rock) => meet_rock(rock, from, direction),
                None => meet_wall(&self.walls[object - self.rocks.len()], from, direction),
            };
            match (distance, best) {
                (Some(d), Some(hit)) if d >= hit.distance_m => Some(hit),
                (Some(distance_m), _) => Some(Hit { distance_m, object }),
                (None, best) => best,
            }
        })
    }
}

fn rock_box(rock: &Rock) -> [f64; 4] {
    let ([x, y], r) = (rock.center_m, rock.radius_m);
    [x - r, y - r, x + r, y + r]
}

fn wall_box(wall: &Wall) -> [f64; 4] {
    let ([ax, ay], [bx, by]) = (wall.from_m, wall.to_m);
    [ax.min(bx), ay.min(by), ax.max(bx), ay.max(by)]
}

fn distance(a: [f64; 2], b: [f64; 2]) -> f64 {
    ((a[0] - b[0]).powi(2) + (a[1] - b[1]).powi(2)).sqrt()
}

/// Distance along the ray to the near side of a rock that the ray starts outside of.
fn meet_rock(rock: &Rock, from: [f64; 2], direction: [f64; 2]) -> Option<f64> {
    let to = [rock.center_m[0] - from[0], rock.center_m[1] - from[1]];
    let along = to[0] * direction[0] + to[1] * direction[1];
    let across = to[0] * direction[1] - to[1] * direction[0];
    let half_chord_squared = rock.radius_m * rock.radius_m - across * across;
    let near = along - half_chord_squared.max(0.0).sqrt();
    (half_chord_squared >= 0.0 && near > 0.0).then_some(near)
}

fn meet_wall(wall: &Wall, from: [f64; 2], direction: [f64; 2]) -> Option<f64> {
    let side = [wall.to_m[0] - wall.from_m[0], wall.to_m[1] - wall.from_m[1]];
    let to = [wall.from_m[0] - from[0], wall.from_m[1] - from[1]];
    let determinant = direction[0] * side[1] - direction[1] * side[0];
    if determinant == 0.0 {
        return None;
    }
    let distance = (to[0] * side[1] - to[1] * side[0]) / determinant;
    let fraction = (to[0] * direction[1] - to[1] * direction[0]) / determinant;
    (distance > 0.0 && (0.0..=1.0).contains(&fraction)).then_some(distance)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rays_end_where_the_geometry_says() {
        let rock = Rock { center_m: [4.0, 1.0], radius_m: 1.0, intensity: 3.0 };
        let wall = Wall { from_m: [10.0, -5.0], to_m: [10.0, 5.0] };
        let arena = Arena::new(vec![rock], vec![wall], 1.0);
        let range = |from, direction| arena.range(from, direction, 50.0);
        assert!((range([0.0, 1.0], [1.0, 0.0]).unwrap() - 3.0).abs() < 1e-12);
        assert!((range([0.0, -2.0], [1.0, 0.0]).unwrap() - 10.0).abs() < 1e-12);
        assert!((range([-30.0, -2.0], [1.0, 0.0]).unwrap() - 40.0).abs() < 1e-12, "from outside of the grid");
        assert_eq!(range([0.0, -6.0], [1.0, 0.0]), None);
        assert_eq!(range([0.0, 0.0], [-1.0, 0.0]), None);
        assert_eq!(arena.range([0.0, 1.0], [1.0, 0.0], 2.5), None);
    }

    #[test]
    fn the_grid_changes_nothing() {
        let coarse = Arena::random(3, 60, 40.0, [0.1, 0.8], 0.4);
        assert_eq!(coarse.rocks().len(), 60);
        let whole = Arena::new(coarse.rocks.clone(), coarse.walls.clone(), 1000.0);
        let mut hits = 0;
        for k in 0..4000 {
            let (s, c) = math::sin_cos(0.01 * f64::from(k));
            let from = [0.004 * f64::from(k) - 8.0, 5.0 * s];
            let (a, b) = (coarse.range(from, [c, s], 100.0), whole.range(from, [c, s], 100.0));
            assert_eq!(a, b, "ray {k}");
            hits += usize::from(a.is_some());
        }
        assert_eq!(hits, 4000, "the walls close the arena");
    }
}

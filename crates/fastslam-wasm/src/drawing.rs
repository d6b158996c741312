//! Numbers to draw: sections of doubles, their lengths before them.

use crate::classroom::{Classroom, Scene};
use crate::observer::{Filter, Observer};

/// Paths of at most so many particles are shown, each of at most so many points.
const PATHS: usize = 40;
const POINTS: usize = 600;

/// Sections one after the other, with their number and lengths first.
fn joined(sections: &[Vec<f64>]) -> Vec<f64> {
    let lengths = sections.iter().map(|section| section.len() as f64);
    std::iter::once(sections.len() as f64).chain(lengths).chain(sections.iter().flatten().copied()).collect()
}

/// The world: (true pose, reported pose, time), landmarks, the true path, the path by odometry, ends of what is seen.
pub fn world(room: &Classroom) -> Vec<f64> {
    match &room.scene {
        Scene::Simulated(world) => {
            let (truth, reported) = (world.T_world_robot, world.T_world_reported);
            let mut now = [truth.to_array(), reported.to_array()].concat();
            now.push(world.ticks as f64 * crate::world::TICK_S);
            let seen = world.seen.iter().flat_map(|seen| world.landmarks[seen.landmark as usize]).collect();
            let (path, reported) = (thinned(&world.path), thinned(&world.reported_path));
            joined(&[now, world.landmarks.concat(), path, reported, seen])
        }
        Scene::Logged(replay) => {
            let reported = replay.T_world_reported;
            let mut now = [[f64::NAN; 3], reported.to_array()].concat();
            now.extend([replay.now_s() - replay.first_s(), replay.last_s() - replay.first_s()]);
            joined(&[now, vec![], vec![], thinned(&replay.reported_path), vec![]])
        }
    }
}

/// What a filter believes now: status, then (x, y, heading, weight) of each particle.
///
/// Status: pose, covariance of the position (xx, xy, yy), effective particles, particles, landmarks, resamplings,
/// redraws, health, mean error of the map.
pub fn now(room: &mut Classroom, seat: usize) -> Vec<f64> {
    let map_error_m = room.map_error_m(seat);
    let observer = &mut room.seats[seat].observer;
    let pose = observer.pose();
    let mut status = pose.mean.to_array().to_vec();
    status.extend([pose.covariance[0][0], pose.covariance[0][1], pose.covariance[1][1]]);
    let info = observer.last;
    status.extend([
        info.weighing.effective_sample_size,
        f64::from(info.sampling.particles.max(1)),
        f64::from(info.landmarks),
    ]);
    status.extend([observer.resamplings, observer.redraws].map(f64::from));
    status.extend([f64::from(info.health.status as u8), map_error_m]);
    let poses = observer.slam().weighted_poses();
    let particles = poses.iter().flat_map(|(pose, weight)| [pose.x, pose.y, pose.heading, *weight]).collect();
    joined(&[status, particles])
}

/// What a filter knows since the last scan: (x, y, covariance, sightings, confirmed) of each landmark; x and y of every
/// landmark of every particle's own map; the best path; paths of some particles, separated by NaN; the last scan as (end,
/// landmark, mistaken); the pose of the best particle.
pub fn map(room: &Classroom, seat: usize) -> Vec<f64> {
    let crate::classroom::Seat { observer, matches, .. } = &room.seats[seat];
    let landmarks = observer.map.landmarks.iter().flat_map(|landmark| {
        let ([x, y], c) = (landmark.mean, landmark.covariance);
        [x, y, c.xx, c.xy, c.yy, f64::from(landmark.sightings), f64::from(u8::from(landmark.confirmed))]
    });
    let matches = matches.iter().flat_map(|m| {
        let [x, y] = m.landmark_m.unwrap_or([f64::NAN; 2]);
        [m.end_m[0], m.end_m[1], x, y, f64::from(u8::from(m.mistaken))]
    });
    let best = observer.best_pose().to_array().to_vec();
    joined(&[landmarks.collect(), own_maps(observer), best_path(observer), paths(observer), matches.collect(), best])
}

fn own_maps(observer: &Observer) -> Vec<f64> {
    let Filter::Particles(filter) = &observer.filter else { return Vec::new() };
    (0..filter.particles().len()).flat_map(|i| filter.map_of(i)).flat_map(|(_, mean, _)| mean).collect()
}

fn best_path(observer: &Observer) -> Vec<f64> {
    let path = match &observer.filter {
        Filter::Particles(filter) => filter.best_path(),
        Filter::Joint(filter) => filter.trail().to_vec(),
    };
    thinned(&path.iter().map(|(_, pose)| [pose.x, pose.y]).collect::<Vec<_>>())
}

fn paths(observer: &Observer) -> Vec<f64> {
    let Filter::Particles(filter) = &observer.filter else { return Vec::new() };
    let step = filter.particles().len().div_ceil(PATHS);
    let mut points = Vec::new();
    for i in (0..filter.particles().len()).step_by(step) {
        let path: Vec<_> = filter.path().path(i).iter().map(|(_, pose)| [pose.x, pose.y]).collect();
        points.extend(thinned(&path));
        points.extend([f64::NAN; 2]);
    }
    points
}

/// At most [`POINTS`] of a path, the newest among them.
fn thinned(path: &[[f64; 2]]) -> Vec<f64> {
    let step = path.len().div_ceil(POINTS).max(1);
    path.iter().rev().step_by(step).rev().flatten().copied().collect()
}

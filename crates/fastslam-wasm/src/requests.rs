//! Requests and answers.

use crate::classroom::{Classroom, Scene, Seat};
use crate::drawing;
use crate::observer::Filter;
use crate::replay::Replay;
use crate::settings::Settings;
use crate::tables::Files;
use serde::Deserialize;
use serde_json::json;

/// What the page may ask.
#[derive(Debug, Deserialize)]
#[serde(tag = "ask", rename_all = "snake_case", deny_unknown_fields)]
pub enum Request {
    /// A simulated world, from its beginning.
    Begin {
        /// What is set.
        settings: Settings,
    },
    /// A native log, from its beginning.
    Load {
        /// The contents of its files.
        files: Files,
        /// What is set.
        settings: Settings,
    },
    /// Drive with this speed and yaw rate.
    Drive {
        /// Metres per second.
        speed: f64,
        /// Radians per second, to the left.
        turn: f64,
        /// For so many ticks.
        ticks: u32,
    },
    /// Drive to a place.
    Towards {
        /// In the world, metres.
        place: [f64; 2],
        /// For so many ticks.
        ticks: u32,
    },
    /// Let the robot drive itself.
    Autopilot {
        /// For so many ticks.
        ticks: u32,
    },
    /// Go on with the log.
    Replay {
        /// In its time.
        seconds: f64,
    },
    /// Draw all paths of a filter anew.
    DrawAnew {
        /// Which.
        filter: usize,
    },
    /// Numbers to draw the world.
    World,
    /// Numbers to draw what a filter believes now.
    Now {
        /// Which.
        filter: usize,
    },
    /// Numbers to draw what a filter knows since the last scan.
    Map {
        /// Which.
        filter: usize,
    },
    /// The bits of all that a filter estimates.
    Bits {
        /// Which.
        filter: usize,
    },
}

/// What it gets.
pub enum Answer {
    /// To draw: see [`drawing`].
    Numbers(Vec<f64>),
    /// Anything else.
    Json(String),
    /// Why not.
    Error(String),
}

impl Default for Answer {
    fn default() -> Self {
        Self::Json("null".into())
    }
}

/// Whoever answers.
#[derive(Default)]
pub struct Desk {
    room: Option<Classroom>,
}

impl Desk {
    /// Answers a request in JSON.
    pub fn answer(&mut self, request: &[u8]) -> Answer {
        let request = serde_json::from_slice(request).map_err(|error| format!("not a request: {error}"));
        request.and_then(|request| self.handle(request)).unwrap_or_else(Answer::Error)
    }

    fn handle(&mut self, request: Request) -> Result<Answer, String> {
        match request {
            Request::Begin { settings } => {
                self.room = Some(Classroom::simulated(&settings)?);
                return Ok(Answer::default());
            }
            Request::Load { files, settings } => {
                let replay = Replay::new(&files, &settings)?;
                let about = json!({"notes": replay.notes, "seconds": replay.last_s() - replay.first_s()});
                self.room = Some(Classroom::logged(replay, &settings)?);
                return Ok(Answer::Json(about.to_string()));
            }
            _ => {}
        }
        let room = self.room.as_mut().ok_or("nothing has begun yet")?;
        let seats = room.seats.len();
        let seat = |filter: usize| (filter < seats).then_some(filter).ok_or("there is no such filter");
        match request {
            Request::Begin { .. } | Request::Load { .. } => {}
            Request::Drive { speed, turn, ticks } => room.drive(ticks, |_| [speed, turn])?,
            Request::Towards { place, ticks } => room.drive(ticks, |world| world.towards(place))?,
            Request::Autopilot { ticks } => room.drive(ticks, |world| world.autopilot())?,
            Request::Replay { seconds } => return Ok(Answer::Json(room.replay(seconds)?.to_string())),
            Request::DrawAnew { filter } => {
                let done = room.seats[seat(filter)?].observer.draw_anew();
                return Ok(Answer::Json(done.to_string()));
            }
            Request::World => return Ok(Answer::Numbers(drawing::world(room))),
            Request::Now { filter } => return Ok(Answer::Numbers(drawing::now(room, seat(filter)?))),
            Request::Map { filter } => return Ok(Answer::Numbers(drawing::map(room, seat(filter)?))),
            Request::Bits { filter } => return Ok(Answer::Json(bits(&room.seats[seat(filter)?]).to_string())),
        }
        Ok(Answer::Json(state(room).to_string()))
    }
}

/// What went wrong, by filter, and whether a robot can be driven.
fn state(room: &Classroom) -> serde_json::Value {
    let failures: Vec<_> = room.seats.iter().map(|seat| seat.observer.failure.clone()).collect();
    json!({"failures": failures, "simulated": matches!(room.scene, Scene::Simulated(_))})
}

/// Particles, weights and map as the hexadecimal digits of their doubles.
fn bits(seat: &Seat) -> serde_json::Value {
    let hex = |numbers: &[f64]| numbers.iter().map(|v| format!("{:016x}", v.to_bits())).collect::<String>();
    let (poses, weights) = match &seat.observer.filter {
        Filter::Particles(filter) => {
            let particles = filter.particles();
            let poses = [&particles.x[..], &particles.y, &particles.heading].concat();
            (poses, filter.weights().to_vec())
        }
        Filter::Joint(filter) => (filter.pose().mean.to_array().to_vec(), filter.pose().covariance.concat()),
    };
    let map: Vec<f64> = seat
        .observer
        .map
        .landmarks
        .iter()
        .flat_map(|l| [l.mean[0], l.mean[1], l.covariance.xx, l.covariance.xy, l.covariance.yy])
        .collect();
    json!({"poses": hex(&poses), "weights": hex(&weights), "map": hex(&map)})
}

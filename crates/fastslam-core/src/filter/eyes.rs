//! Several sensors: what is known of each, and that of the one whose scan it is in its place.

use super::fading::{Acuity, Fading};
use super::setup::{Setup, Setups};
use crate::diagnosis::by_sensor::BySensor;
use crate::diagnosis::health::{Gaze, View, Watch};
use serde::{Deserialize, Serialize};

/// What is known of one sensor.
#[derive(Clone, Serialize, Deserialize)]
pub(super) struct Eye {
    gaze: Gaze,
    acuity: Acuity,
}

impl Eye {
    /// Exchanges what is known of this sensor with what is in use.
    pub fn swap(&mut self, watch: &mut Watch, fading: Option<&mut Fading>) {
        watch.swap(&mut self.gaze);
        if let Some(fading) = fading {
            fading.swap(&mut self.acuity);
        }
    }
}

/// What is known of each sensor; of the only one nothing stands here.
pub(super) type Eyes = BySensor<Eye>;

/// Of sensors that have not looked yet.
pub(super) fn fresh_eyes<M>(setups: &Setups<M>) -> Eyes {
    let eye = |setup: &Setup<M>| {
        let config = &setup.settings.config;
        Eye { gaze: Gaze::new(View::of(config)), acuity: Acuity::new(config.sensor.common()) }
    };
    match setups.each() {
        [_] => Eyes::default(),
        several => Eyes::new(several.iter().map(eye)),
    }
}

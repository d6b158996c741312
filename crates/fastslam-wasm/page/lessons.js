"use strict";
/* What the page tells, step by step, and what it sets for that. */

const LESSONS = [
  { title: "1. Two filters, one robot",
    text: "The robot drives round by itself; take over whenever you like. Left and right the same things happen, seen by " +
      "FastSLAM 1.0 and 2.0. Grey is where the odometry alone says the robot is: it drifts away for ever. The filters stay " +
      "with the robot (dark outline), because they map landmarks and see them again.",
    set: { filters: ["fastslam1", "fastslam2"], particles: 100, names: false, redraws: "never", landmarks: 40, reach_m: 8,
      odometry_noise: 1, sensor_noise: 1, believed_noise: 1 } },
  { title: "2. Every particle is a whole hypothesis",
    text: "A blue dot is a particle: one possible path of the robot, with a map of its own. Given a path, landmarks are " +
      "independent of each other, so each is one small Gaussian: the light dots are one landmark as the particles have it. " +
      "With few landmarks in sight the particles spread; one familiar landmark pulls them together.",
    set: { filters: ["fastslam2"], landmarks: 15, reach_m: 6, odometry_noise: 2 } },
  { title: "3. Resampling",
    text: "The strip under a map shows how many particles still count. When few do, the filter resamples: particles that " +
      "explain the sightings are copied, the others die, with their paths and maps. Look at the blue paths: they share " +
      "ever more of the past. That is the price: what all survivors share cannot be doubted any more.",
    set: { filters: ["fastslam1"], particles: 50, landmarks: 30, reach_m: 8, odometry_noise: 2 } },
  { title: "4. 2.0 looks before it leaps",
    text: "With an exact sensor and poor odometry most particles of 1.0 land where the sighting says they cannot be. 2.0 " +
      "takes the sighting into account when it draws a pose, so it needs far fewer. Here are ten particles each: compare " +
      "the errors and the strips.",
    set: { filters: ["fastslam1", "fastslam2"], particles: 10, landmarks: 40, reach_m: 8, odometry_noise: 3,
      sensor_noise: 0.3 } },
  { title: "5. Which landmark is it?",
    text: "Nobody says which landmark is which: each particle decides for itself. Green lines lead from sightings to the " +
      "landmarks of the best particle; where one is taken for another, the line is pink. Landmarks stand closely here and " +
      "the sensor is poor. Tick “they are told which landmark is which” to see what that costs.",
    set: { filters: ["fastslam2", "ekf"], particles: 100, landmarks: 120, sensor_noise: 3, odometry_noise: 2,
      names: false } },
  { title: "6. EKF-SLAM beside it",
    text: "EKF-SLAM keeps one Gaussian over the pose and all landmarks, with all correlations: one hypothesis, never " +
      "resampled, and work that grows with the square of the map. On a world of this size it is very accurate while its " +
      "associations are right. It cannot take back a wrong one.",
    set: { filters: ["fastslam2", "ekf"], particles: 100, landmarks: 40, sensor_noise: 1, odometry_noise: 1, names: false } },
  { title: "7. Drawing paths anew",
    text: "Resampling throws the past away; that can be undone. Given what the best particle took its sightings for, all " +
      "whole paths are drawn anew from their posterior, and the maps with them. Let the robot drive a round, press “Draw " +
      "paths anew now” and watch the blue paths fan out again, all of them consistent with everything seen.",
    set: { filters: ["fastslam1"], particles: 50, landmarks: 40, reach_m: 8, odometry_noise: 2, redraws: "on_request" } },
  { title: "8. Wrong beliefs about noise",
    text: "The filters believe in a third of the sensor's true noise here. The ellipses are too small and landmarks are " +
      "founded twice. The line above a map says what the filter thinks of itself; it does not always notice. Set “the filters believe in” to 1.0 × and compare. On a robot " +
      "of your own, fastslam doctor finds such noise from a log.",
    set: { filters: ["fastslam2", "ekf"], particles: 100, landmarks: 40, sensor_noise: 2, odometry_noise: 1,
      believed_noise: 0.33, redraws: "never" } },
];

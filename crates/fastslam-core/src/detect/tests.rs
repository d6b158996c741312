//! Scans whose answer is known.

use super::*;

#[test]
fn scratch() {
    let step = 0.5_f64.to_radians();
    for (radius, range) in [(0.5, 22.0), (0.5, 10.0), (0.2, 8.0)] {
        let mut sums = [0.0; 2];
        for k in 0..40 {
            let bearing = step * (k as f64 + 0.5) / 40.0;
            let ranges: Vec<f64> = (0..361)
                .map(|i| {
                    let off = (i as f64 - 180.0) * step - bearing;
                    let across = range * off.sin();
                    if across.abs() < radius { range * off.cos() - (radius * radius - across * across).sqrt() } else { f64::INFINITY }
                })
                .collect();
            let mut found = vec![];
            let geometry = BeamGeometry { first_angle_rad: -180.0 * step, angle_step_rad: step, min_range_m: 0.1, max_range_m: 80.0, beam_period_s: None };
            Detector::new(DetectorConfig::default()).unwrap().detect(&Scan { ranges_m: &ranges, intensities: None, geometry, twist: None }, &mut found).unwrap();
            for d in &found {
                if radius == 0.5 && range == 22.0 {
                    println!("{k} n {} radial {:.1} tang {:.1} diam {:.1} mm", d.last_beam - d.first_beam + 1, 1e3 * (d.range_m - range), 1e3 * range * (d.bearing_rad - bearing), 1e3 * (d.signature - 2.0 * radius));
                }
                sums[0] += 1e3 * (d.range_m - range) / 40.0;
                sums[1] += 1e3 * (d.signature - 2.0 * radius) / 40.0;
            }
        }
        println!("{radius} {range}: radial {:.2} diam {:.2}", sums[0], sums[1]);
    }
}

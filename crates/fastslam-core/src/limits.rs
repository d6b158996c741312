//! What no robot's numbers exceed, in one place: beyond this, squares and products of them lose what they are for.

/// Positions in the world, metres: those of any map projection of the Earth are smaller, and neighbours at this distance from
/// the origin are 15 nm apart.
pub const FARTHEST_M: f64 = 1e8;
/// Lengths, metres: a thousand kilometres.
pub const LONGEST_M: f64 = 1e6;
/// Angles, radians: 160 turns.
pub const WIDEST_RAD: f64 = 1e3;
/// Durations, seconds: thirty years.
pub const LONGEST_S: f64 = 1e9;
/// Speeds and yaw rates, displacements and turns of one row of odometry, noise per root metre: beyond this, angles lose
/// their meaning.
pub const LARGEST_RATE: f64 = 1e6;
/// Numbers without a unit.
pub const LARGEST_NUMBER: f64 = 1e12;
/// What must be positive, or is other than 0, is at least this in size.
pub const LEAST: f64 = 1e-12;
/// No number of a state is larger: squares of larger ones, and products of these, are none.
pub const LARGEST_STATE: f64 = 1e30;

/// The largest size of a setting by the unit that ends its key; the first that fits counts.
pub const BY_UNIT: [(&str, f64); 7] = [
    ("_per_s", LARGEST_RATE),
    ("_per_sqrt_m", LARGEST_RATE),
    ("_per_sqrt_rad", LARGEST_RATE),
    ("_m", LONGEST_M),
    ("_rad", WIDEST_RAD),
    ("_s", LONGEST_S),
    ("", LARGEST_NUMBER),
];

/// The largest size of a setting, by its unit.
pub fn largest(key: &str) -> f64 {
    BY_UNIT.iter().find(|(unit, _)| key.ends_with(unit)).map_or(LARGEST_NUMBER, |(_, most)| *most)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_unit_that_ends_a_key_bounds_it() {
        for (key, most) in [
            ("sensor.max_range_m", 1e6),
            ("speed_std_m_per_s", 1e6),
            ("proportional.turn_std_rad_per_sqrt_m", 1e6),
            ("proportional.turn_std_rad_per_sqrt_rad", 1e6),
            ("field_of_view_rad", 1e3),
            ("noise_period_s", 1e9),
            ("tail_degrees_of_freedom", 1e12),
        ] {
            assert_eq!(largest(key), most, "{key}");
        }
    }
}

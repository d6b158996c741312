//! The integration tests as one program: the filter is generic and would be compiled anew for each of many.
//!
//! `cargo test -p fastslam-core --test all oracle` runs those of one file. Only `allocations`, which replaces the
//! allocator, is a program of its own.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)] // That is how a test fails.

mod association;
mod association_methods;
mod beside;
mod blind;
mod dense;
mod ekf_linear_world;
mod ekf_textbook;
mod existence;
mod fading;
mod fuzz;
mod given_map;
mod golden;
mod life_cycle;
mod linear_world;
mod metamorphic;
mod mixed_sensors;
mod oracle_linear_gaussian;
mod path_period;
mod randomness;
mod range_only;
mod rejuvenation;
mod robustness;
mod scans;
mod several_sensors;
mod space;
mod state;
mod stores_agree;
mod stores_agree_on_logs;
mod stream;
mod threads;

#[test]
fn every_file_of_tests_is_part_of_this_program_or_a_program_of_its_own() {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/tests");
    let manifest = include_str!("../Cargo.toml");
    let mut named = 0;
    for entry in std::fs::read_dir(folder).unwrap() {
        let name = entry.unwrap().file_name().into_string().unwrap();
        let Some(stem) = name.strip_suffix(".rs") else { continue };
        let module = include_str!("all.rs").contains(&format!("\nmod {stem};"));
        assert!(module || manifest.contains(&format!("path = \"tests/{name}\"")), "{name} is never run");
        named += u32::from(module);
    }
    assert!(named > 10, "{named}");
}

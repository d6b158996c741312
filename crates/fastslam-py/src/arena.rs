//! Bindings of the arena: scans by casting rays.

use crate::settings::{from_json, to_python};
use fastslam_core::detect::BeamGeometry;
use fastslam_core::error::{finite, non_negative, Result};
use fastslam_core::geometry::Pose;
use fastslam_core::random::RandomSource;
use fastslam_sim::arena::{Arena, Laser, Rock, Wall};
use numpy::ndarray::ArrayView2;
use numpy::{IntoPyArray, PyArray2, PyArrayMethods, PyReadonlyArray2};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

/// Side of a cell of the arena's index.
const CELL_M: f64 = 1.0;

fn rows<const N: usize>(view: ArrayView2<'_, f64>, what: &str) -> PyResult<Vec<[f64; N]>> {
    if view.ncols() != N {
        return Err(PyValueError::new_err(format!("{what}: got {} columns, expected {N}", view.ncols())));
    }
    Ok(view.rows().into_iter().map(|row| std::array::from_fn(|i| row[i])).collect())
}

fn validate(laser: &Laser, obstacles: &[&[f64]]) -> Result<()> {
    laser.geometry.validate(laser.beams).map_err(|e| e.within("geometry"))?;
    non_negative("range_std_m", laser.range_std_m)?;
    non_negative("dropout_probability", laser.dropout_probability)?;
    obstacles.iter().flat_map(|row| row.iter()).try_for_each(|value| finite("obstacles", *value).map(|_| ()))
}

/// Scans of an arena from given poses of the sensor: ranges (T, beams), infinite where nothing was hit, NaN where a beam
/// dropped out. `rocks` (N, 3) are x, y, radius; `walls` (W, 4) their two ends.
#[pyfunction]
#[allow(clippy::too_many_arguments)] // One argument per part of the arena and of the laser.
fn scan_arena<'py>(
    py: Python<'py>,
    rocks: PyReadonlyArray2<'py, f64>,
    walls: PyReadonlyArray2<'py, f64>,
    T_world_sensor: PyReadonlyArray2<'py, f64>,
    geometry_json: &str,
    beams: usize,
    range_std_m: f64,
    dropout_probability: f64,
    seed: u64,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let rocks = rows::<3>(rocks.as_array(), "rocks")?;
    let walls = rows::<4>(walls.as_array(), "walls")?;
    let poses = rows::<3>(T_world_sensor.as_array(), "T_world_sensor")?;
    let geometry: BeamGeometry = from_json(geometry_json)?;
    let laser = Laser { beams, geometry, range_std_m, dropout_probability };
    let obstacles: Vec<&[f64]> =
        rocks.iter().map(|r| &r[..]).chain(walls.iter().map(|w| &w[..])).chain(poses.iter().map(|p| &p[..])).collect();
    validate(&laser, &obstacles).map_err(to_python)?;
    let rocks = rocks.iter().map(|&[x, y, radius_m]| Rock { center_m: [x, y], radius_m, intensity: 0.0 }).collect();
    let walls = walls.iter().map(|&[a, b, c, d]| Wall { from_m: [a, b], to_m: [c, d] }).collect();
    let ranges: Vec<f64> = py.detach(|| {
        let arena = Arena::new(rocks, walls, CELL_M);
        let random = RandomSource::new(seed);
        let scan = |(number, pose): (u64, &[f64; 3])| arena.scan(Pose::from(*pose), [0.0; 3], &laser, random, number);
        (0..).zip(&poses).flat_map(|pose| scan(pose).ranges_m).collect()
    });
    ranges.into_pyarray(py).reshape([poses.len(), beams])
}

/// Adds everything here to the module.
pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_function(wrap_pyfunction!(scan_arena, module)?)
}

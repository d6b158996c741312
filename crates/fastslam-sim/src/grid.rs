//! Points in a uniform grid.

/// A set of points of the plane that answers "which are near here" without looking at all of them.
///
/// Each cell heads a linked list through `next`, so that inserting is constant time and the memory is that of the
/// points plus at most a few cells per point, whatever the cell size that was asked for.
#[derive(Clone, Debug)]
pub struct PointGrid {
    origin: [f64; 2],
    cell_m: f64,
    columns: usize,
    rows: usize,
    head: Vec<u32>,
    next: Vec<u32>,
    points: Vec<[f64; 2]>,
}

const END: u32 = u32::MAX;

impl PointGrid {
    /// An empty grid over the rectangle from `min` to `max`; points outside of it fall into its border cells.
    ///
    /// `cell_m` is a wish: cells are larger where `expected_points` would otherwise be lost among empty cells.
    pub fn new(min: [f64; 2], max: [f64; 2], cell_m: f64, expected_points: usize) -> Self {
        let size = [(max[0] - min[0]).max(1e-9), (max[1] - min[1]).max(1e-9)];
        let cells = 2.0 * expected_points.max(8) as f64;
        // Both bounds matter: the area for a square field, the longer side for a line of points.
        let cell_m = cell_m.max((size[0] * size[1] / cells).sqrt()).max(size[0].max(size[1]) / cells);
        let count = |length: f64| (length / cell_m) as usize + 1;
        let (columns, rows) = (count(size[0]), count(size[1]));
        Self { origin: min, cell_m, columns, rows, head: vec![END; columns * rows], next: vec![], points: vec![] }
    }

    /// A grid that holds these points, numbered in their order.
    pub fn from_points(points: &[[f64; 2]], cell_m: f64) -> Self {
        let (min, max) = bounding_box(points);
        let mut grid = Self::new(min, max, cell_m, points.len());
        for &point in points {
            grid.insert(point);
        }
        grid
    }

    /// Adds a point; its number is the count of points before it.
    pub fn insert(&mut self, point: [f64; 2]) {
        let cell = self.column(point[0]) + self.row(point[1]) * self.columns;
        self.next.push(self.head[cell]);
        self.head[cell] = self.points.len() as u32;
        self.points.push(point);
    }

    /// The points, in order of insertion.
    pub fn points(&self) -> &[[f64; 2]] {
        &self.points
    }

    /// Calls `visit` with number and squared distance of every point within `radius_m` of `center`, in no
    /// particular order, until it returns false.
    pub fn visit_within(&self, center: [f64; 2], radius_m: f64, mut visit: impl FnMut(usize, f64) -> bool) {
        for row in self.row(center[1] - radius_m)..=self.row(center[1] + radius_m) {
            for column in self.column(center[0] - radius_m)..=self.column(center[0] + radius_m) {
                let mut index = self.head[column + row * self.columns];
                while index != END {
                    let squared = squared_distance(self.points[index as usize], center);
                    if squared <= radius_m * radius_m && !visit(index as usize, squared) {
                        return;
                    }
                    index = self.next[index as usize];
                }
            }
        }
    }

    /// Whether any point lies nearer than `radius_m`.
    pub fn any_within(&self, center: [f64; 2], radius_m: f64) -> bool {
        let mut found = false;
        self.visit_within(center, radius_m, |_, squared| {
            found = squared < radius_m * radius_m;
            !found
        });
        found
    }

    fn column(&self, x: f64) -> usize {
        // A cast to an unsigned number saturates, which puts what lies outside into the border cells.
        (((x - self.origin[0]) / self.cell_m) as usize).min(self.columns - 1)
    }

    fn row(&self, y: f64) -> usize {
        (((y - self.origin[1]) / self.cell_m) as usize).min(self.rows - 1)
    }
}

/// Corners (least, greatest) of the smallest upright rectangle around some points; both zero without points.
pub fn bounding_box(points: &[[f64; 2]]) -> ([f64; 2], [f64; 2]) {
    let Some(&first) = points.first() else { return ([0.0; 2], [0.0; 2]) };
    points.iter().fold((first, first), |(low, high), p| {
        ([low[0].min(p[0]), low[1].min(p[1])], [high[0].max(p[0]), high[1].max(p[1])])
    })
}

fn squared_distance(a: [f64; 2], b: [f64; 2]) -> f64 {
    (a[0] - b[0]) * (a[0] - b[0]) + (a[1] - b[1]) * (a[1] - b[1])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::draws::{Draws, Part};

    #[test]
    fn finds_what_brute_force_finds() {
        let stream = Draws::new(3).stream(Part::World, 0);
        let points: Vec<[f64; 2]> =
            (0..3000_u32).map(|i| stream.uniform_pair(i, 0)).map(|[u, v]| [200.0 * u - 50.0, 40.0 * v * v]).collect();
        let mut found_in_all = 0;
        for (query, radius) in [(0_u32, 0.5), (1, 3.0), (2, 25.0), (3, 500.0), (4, 1e-9)] {
            for cell_m in [0.01, 2.0, 1000.0] {
                let grid = PointGrid::from_points(&points, cell_m);
                let [u, v] = stream.uniform_pair(query, 1);
                // Some centres lie outside of the grid.
                let center = [300.0 * u - 100.0, 80.0 * v - 20.0];
                let mut found = vec![];
                grid.visit_within(center, radius, |i, _| {
                    found.push(i);
                    true
                });
                found.sort_unstable();
                let expected: Vec<usize> =
                    (0..points.len()).filter(|&i| squared_distance(points[i], center) <= radius * radius).collect();
                assert_eq!(found, expected);
                assert_eq!(grid.any_within(center, radius), !expected.is_empty());
                found_in_all += found.len();
            }
        }
        assert!(found_in_all > 3000, "{found_in_all}");
    }

    #[test]
    fn memory_is_bounded_by_the_points_for_any_cell_size() {
        let line: Vec<[f64; 2]> = (0..1000).map(|i| [f64::from(i) * 1000.0, 0.0]).collect();
        assert!(PointGrid::from_points(&line, 1e-6).head.len() <= 2500);
        assert_eq!(PointGrid::from_points(&[], 1.0).head.len(), 1);
    }
}

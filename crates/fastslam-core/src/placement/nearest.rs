//! The nearest of many points, by the cells of a grid.

/// Points in cells of about one point each, row by row; `starts` says where the points of a cell begin.
#[derive(Clone, Debug)]
pub struct Nearest {
    low: [f64; 2],
    cell_m: f64,
    size: [usize; 2],
    starts: Vec<u32>,
    rows: Vec<u32>,
    points: Vec<[f64; 2]>,
}

impl Nearest {
    /// Of points with finite coordinates.
    pub fn new(points: &[[f64; 2]]) -> Self {
        let mut low = [f64::INFINITY; 2];
        let mut high = [f64::NEG_INFINITY; 2];
        for point in points {
            for axis in 0..2 {
                low[axis] = low[axis].min(point[axis]);
                high[axis] = high[axis].max(point[axis]);
            }
        }
        let extent = [0, 1].map(|axis| (high[axis] - low[axis]).max(1e-3));
        let count = points.len().max(1) as f64;
        // A strip has fewer cells than points, never more.
        let cell_m = (extent[0] * extent[1] / count).sqrt().max(extent[0].max(extent[1]) / count);
        let size = extent.map(|length| (length / cell_m) as usize + 1);
        let mut grid = Self { low, cell_m, size, starts: Vec::new(), rows: Vec::new(), points: Vec::new() };
        let cells: Vec<usize> = points.iter().map(|point| grid.index(grid.cell(*point))).collect();
        let mut order: Vec<u32> = (0..points.len() as u32).collect();
        order.sort_by_key(|&row| cells[row as usize]);
        grid.starts = vec![0; size[0] * size[1] + 1];
        for cell in cells {
            grid.starts[cell + 1] += 1;
        }
        for cell in 1..grid.starts.len() {
            grid.starts[cell] += grid.starts[cell - 1];
        }
        grid.points = order.iter().map(|&row| points[row as usize]).collect();
        grid.rows = order;
        grid
    }

    /// The side of a cell: about one point lies in each.
    pub fn cell_m(&self) -> f64 {
        self.cell_m
    }

    /// Row and squared distance of the nearest point that is no further than `reach_m`; the lowest row of several.
    #[inline]
    pub fn within(&self, place: [f64; 2], reach_m: f64) -> Option<(usize, f64)> {
        let mut best: Option<(usize, f64)> = None;
        self.each(place, reach_m, |row, distance2| {
            let nearer = best.is_none_or(|(other, least)| (distance2, row) < (least, other));
            if nearer && distance2 <= reach_m * reach_m {
                best = Some((row, distance2));
            }
        });
        best
    }

    /// Calls with row and squared distance of every point in the cells around a place.
    #[inline]
    pub fn each(&self, place: [f64; 2], reach_m: f64, mut visit: impl FnMut(usize, f64)) {
        let outside = |axis: usize| {
            place[axis] + reach_m < self.low[axis]
                || place[axis] - reach_m > self.low[axis] + self.cell_m * self.size[axis] as f64
        };
        if self.points.is_empty() || outside(0) || outside(1) {
            return;
        }
        let first = self.cell([place[0] - reach_m, place[1] - reach_m]);
        let last = self.cell([place[0] + reach_m, place[1] + reach_m]);
        for y in first[1]..=last[1] {
            let begin = self.starts[self.index([first[0], y])] as usize;
            let end = self.starts[self.index([last[0], y]) + 1] as usize;
            for at in begin..end {
                let [dx, dy] = [self.points[at][0] - place[0], self.points[at][1] - place[1]];
                visit(self.rows[at] as usize, dx * dx + dy * dy);
            }
        }
    }

    fn cell(&self, place: [f64; 2]) -> [usize; 2] {
        [0, 1].map(|axis| (((place[axis] - self.low[axis]) / self.cell_m) as usize).min(self.size[axis] - 1))
    }

    fn index(&self, cell: [usize; 2]) -> usize {
        cell[1] * self.size[0] + cell[0]
    }
}

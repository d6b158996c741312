//! The numbers of a sparse Cholesky factor, row after row; columns of one structure are met together.
//!
//! **Source:** up-looking Cholesky: row k of L solves L x = A's column k, in the order of the elimination tree. **Why by
//! hand:** every number is subtracted from in the same order as one column at a time has it, so that all processors give
//! the same bits; and poses and landmarks make two to many columns that have the same rows below them, whose numbers are
//! read, and subtracted from, once for four of them. What only depends on the structure is kept for all matrices that have it.

use super::triangle::UpperTriangle;

/// Where the numbers of a factor stand: the start of each column (one more than columns), and the row of each number,
/// ascending from the diagonal.
#[derive(Clone, Copy)]
pub struct Places<'a> {
    pub starts: &'a [usize],
    pub rows: &'a [usize],
}

/// What factorising a matrix of one structure goes by.
pub struct Elimination {
    /// Where the entries of each column of the matrix in its new order start; one more than columns.
    starts: Vec<usize>,
    /// Row in the new order and place among the values of the matrix.
    entries: Vec<[u32; 2]>,
    /// Where the runs of each row of the factor start; one more than rows.
    run_starts: Vec<usize>,
    /// First and number of columns of one structure that a row meets one after the other.
    runs: Vec<[u32; 2]>,
}

/// A factor that is filled row by row.
struct Filling<'a> {
    places: Places<'a>,
    values: &'a mut [f64],
    /// What is left of the row.
    row: Vec<f64>,
    /// One over each diagonal.
    reciprocals: Vec<f64>,
    /// Where the last number of each column so far stands.
    filled: Vec<usize>,
}

impl Elimination {
    /// For a matrix whose variable v comes at `position(v)`.
    pub fn new(matrix: &UpperTriangle, position: impl Fn(usize) -> usize, places: Places<'_>) -> Self {
        let (starts, entries) = reordered(matrix, position);
        let size = starts.len() - 1;
        let (mut run_starts, mut runs) = (vec![0], Vec::<[u32; 2]>::new());
        let mut reach = Reach { visited: vec![usize::MAX; size], order: vec![0; size] };
        for k in 0..size {
            let columns = reach.of(k, &entries[starts[k]..starts[k + 1]], places);
            let first = runs.len();
            for &column in columns {
                match runs[first..].last_mut() {
                    Some([from, count]) if *from + *count == column && places.continue_in(column) => *count += 1,
                    _ => runs.push([column, 1]),
                }
            }
            run_starts.push(runs.len());
        }
        Self { starts, entries, run_starts, runs }
    }

    /// Fills the factor of a matrix with these values; false when it is not positive definite.
    #[must_use]
    pub fn factorize(&self, matrix: &[f64], places: Places<'_>, values: &mut [f64]) -> bool {
        let size = self.starts.len() - 1;
        let filled = places.starts[..size].to_vec();
        let (row, reciprocals) = (vec![0.0; size], vec![0.0; size]);
        let mut filling = Filling { places, values, row, reciprocals, filled };
        for k in 0..size {
            for [row, place] in &self.entries[self.starts[k]..self.starts[k + 1]] {
                filling.row[*row as usize] += matrix[*place as usize];
            }
            let mut pivot = std::mem::take(&mut filling.row[k]);
            for [first, count] in &self.runs[self.run_starts[k]..self.run_starts[k + 1]] {
                pivot = filling.meet_run(*first as usize, *count as usize, pivot);
            }
            if pivot.is_nan() || pivot <= 0.0 {
                return false;
            }
            let root = pivot.sqrt();
            filling.values[places.starts[k]] = root;
            filling.reciprocals[k] = 1.0 / root;
        }
        true
    }
}

impl Places<'_> {
    /// The column that a column is eliminated into; none of the last of its kind.
    fn parent(&self, column: usize) -> Option<usize> {
        self.rows[self.starts[column] + 1..self.starts[column + 1]].first().copied()
    }

    fn count(&self, column: usize) -> usize {
        self.starts[column + 1] - self.starts[column]
    }

    /// Whether the column before this one has the rows of this one and no other.
    fn continue_in(&self, column: u32) -> bool {
        let (column, before) = (column as usize, column as usize - 1);
        self.parent(before) == Some(column) && self.count(before) == self.count(column) + 1
    }
}

/// The upper triangle of the matrix in its new order, column by column: starts and entries.
fn reordered(matrix: &UpperTriangle, position: impl Fn(usize) -> usize) -> (Vec<usize>, Vec<[u32; 2]>) {
    let size = matrix.column_starts.len() - 1;
    let positions: Vec<usize> = (0..size).map(position).collect();
    let all = || {
        (0..size).flat_map(|column| {
            (matrix.column_starts[column]..matrix.column_starts[column + 1]).map(move |p| (column, p))
        })
    };
    let ends = |(column, place): (usize, usize)| {
        let [a, b] = [positions[matrix.rows[place]], positions[column]];
        [a.min(b), a.max(b)]
    };
    let mut starts = vec![0; size + 1];
    all().for_each(|entry| starts[ends(entry)[1] + 1] += 1);
    (0..size).for_each(|column| starts[column + 1] += starts[column]);
    let (mut next, mut entries) = (starts.clone(), vec![[0; 2]; matrix.rows.len()]);
    for entry in all() {
        let [row, column] = ends(entry);
        entries[next[column]] = [row as u32, entry.1 as u32];
        next[column] += 1;
    }
    (starts, entries)
}

/// Finds the columns that have a number in a row.
struct Reach {
    /// The last row that asked for a column.
    visited: Vec<usize>,
    order: Vec<u32>,
}

impl Reach {
    /// The columns with a number in row `k`, each before the one that it is eliminated into.
    fn of(&mut self, k: usize, entries: &[[u32; 2]], places: Places<'_>) -> &[u32] {
        let mut top = self.order.len();
        self.visited[k] = k;
        for [row, _] in entries.iter().filter(|[row, _]| (*row as usize) < k) {
            let (mut next, mut found) = (Some(*row as usize), 0);
            while let Some(column) = next.filter(|column| self.visited[*column] != k) {
                self.order[found] = column as u32;
                found += 1;
                self.visited[column] = k;
                next = places.parent(column);
            }
            self.order.copy_within(..found, top - found);
            top -= found;
        }
        &self.order[top..]
    }
}

impl Filling<'_> {
    /// Meets so many columns of one structure; returns what is left of the pivot.
    fn meet_run(&mut self, mut first: usize, mut count: usize, mut pivot: f64) -> f64 {
        while count >= 4 {
            pivot = self.meet::<4>(first, pivot);
            (first, count) = (first + 4, count - 4);
        }
        match count {
            3 => self.meet::<3>(first, pivot),
            2 => self.meet::<2>(first, pivot),
            1 => self.meet::<1>(first, pivot),
            _ => pivot,
        }
    }

    #[inline(always)]
    fn meet<const W: usize>(&mut self, first: usize, mut pivot: f64) -> f64 {
        let Self { places, values, row, reciprocals, filled } = self;
        let mut own = [0.0; W];
        for a in 0..W {
            let column = first + a;
            own[a] = std::mem::take(&mut row[column]) * reciprocals[column];
            for b in a + 1..W {
                row[first + b] -= values[places.starts[column] + b - a] * own[a];
            }
            pivot -= own[a] * own[a];
        }
        let last = first + W - 1;
        let (start, count) = (places.starts[last] + 1, filled[last] - places.starts[last]);
        let columns: [&[f64]; W] = std::array::from_fn(|a| &values[places.starts[first + a] + W - a..][..count]);
        for (i, below) in places.rows[start..][..count].iter().enumerate() {
            let mut left = row[*below];
            for a in 0..W {
                left -= columns[a][i] * own[a];
            }
            row[*below] = left;
        }
        for a in 0..W {
            filled[first + a] += 1;
            values[filled[first + a]] = own[a];
        }
        pivot
    }
}

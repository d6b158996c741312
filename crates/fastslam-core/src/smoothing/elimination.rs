//! The numbers of a sparse Cholesky factor, row after row; columns of one structure are met together.
//!
//! **Source:** up-looking Cholesky: row k of L solves L x = A's column k, in the order of the elimination tree. **Why by
//! hand:** every number is subtracted from in the same order as one column at a time has it, so that all processors give
//! the same bits; and poses and landmarks make two to many columns that have the same rows below them, whose numbers are
//! read, and subtracted from, once for four of them. What only depends on the structure is kept for all matrices that have it.

use super::symbolic::{Order, Places, Reach, Reordered, Tree};
use super::triangle::UpperTriangle;

/// What factorising a matrix of one structure goes by.
pub struct Elimination {
    matrix: Reordered,
    places: Places,
    /// Where the runs of each row of the factor start; one more than rows.
    run_starts: Vec<usize>,
    /// First and number of columns of one structure that a row meets one after the other.
    runs: Vec<[u32; 2]>,
}

/// A factor that is filled row by row.
struct Filling<'a> {
    starts: &'a [usize],
    rows: &'a [usize],
    values: &'a mut [f64],
    /// What is left of the row.
    row: Vec<f64>,
    /// One over each diagonal.
    reciprocals: Vec<f64>,
    /// Where the last number of each column so far stands.
    filled: Vec<usize>,
}

impl Elimination {
    /// `None` when there is no memory for it.
    pub fn new(matrix: &UpperTriangle, order: &Order) -> Option<Self> {
        let matrix = Reordered::of(matrix, order);
        let size = matrix.size();
        let (tree, mut reach) = (Tree::of(&matrix)?, Reach::new(size)?);
        let mut places = Places::of(&tree)?;
        let mut next = places.starts.clone();
        let (mut run_starts, mut runs) = (vec![0], Vec::<[u32; 2]>::new());
        for k in 0..size {
            let first = runs.len();
            for &column in reach.of(k, &matrix, &tree) {
                places.add(k, column, &mut next);
                match runs[first..].last_mut() {
                    Some([from, count]) if (*from + *count) as usize == column && tree.continues_in(column) => {
                        *count += 1
                    }
                    _ => runs.push([column as u32, 1]),
                }
            }
            places.add(k, k, &mut next);
            run_starts.push(runs.len());
        }
        Some(Self { matrix, places, run_starts, runs })
    }

    /// Where the numbers of the factor stand.
    pub fn places(&self) -> &Places {
        &self.places
    }

    /// Fills the factor of a matrix with these values; false when it is not positive definite.
    #[must_use]
    pub fn factorize(&self, matrix: &[f64], values: &mut [f64]) -> bool {
        let size = self.matrix.size();
        let Places { starts, rows } = &self.places;
        let (row, reciprocals) = (vec![0.0; size], vec![0.0; size]);
        let mut filling = Filling { starts, rows, values, row, reciprocals, filled: starts[..size].to_vec() };
        for k in 0..size {
            for [row, place] in self.matrix.column(k) {
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
            filling.values[starts[k]] = root;
            filling.reciprocals[k] = 1.0 / root;
        }
        true
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
        let Self { starts, rows, values, row, reciprocals, filled } = self;
        let mut own = [0.0; W];
        for a in 0..W {
            let column = first + a;
            own[a] = std::mem::take(&mut row[column]) * reciprocals[column];
            for b in a + 1..W {
                row[first + b] -= values[starts[column] + b - a] * own[a];
            }
            pivot -= own[a] * own[a];
        }
        let last = first + W - 1;
        let (start, count) = (starts[last] + 1, filled[last] - starts[last]);
        let columns: [&[f64]; W] = std::array::from_fn(|a| &values[starts[first + a] + W - a..][..count]);
        for (i, below) in rows[start..][..count].iter().enumerate() {
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

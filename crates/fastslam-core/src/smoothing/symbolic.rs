//! Where the numbers of a sparse Cholesky factor stand, for an order of the variables that keeps them few.
//!
//! **Source:** `amestoy2004amd` for the order; `liu1990elimination` for the rest: column j of L goes into the column of its
//! first number below the diagonal, its parent in the elimination tree, and row k of L has numbers in the columns on the
//! paths up this tree from the entries of row k of A.

use super::triangle::UpperTriangle;
use std::hint::black_box;

/// In which order the variables of a matrix are eliminated.
pub struct Order {
    variables: Vec<usize>,
    positions: Vec<usize>,
}

impl Order {
    /// The order of approximate minimum degree; `None` when there is no memory to find it.
    pub fn of_least_degree(matrix: &UpperTriangle) -> Option<Self> {
        let UpperTriangle { column_starts, rows, .. } = matrix;
        // What `amd` allocates, which would abort: a copy of the matrix, both of its triangles with a fifth to spare, and
        // at most twenty numbers per variable.
        black_box(reserved::<usize>(4 * rows.len() + 20 * column_starts.len())?);
        let (variables, positions, _) =
            amd::order(matrix.size(), column_starts, rows, &amd::Control::default()).ok()?;
        Some(Self { variables, positions })
    }

    /// The order that the variables have.
    pub fn as_given(size: usize) -> Self {
        Self { variables: (0..size).collect(), positions: (0..size).collect() }
    }

    /// The variable that comes at a position.
    pub fn variable(&self, position: usize) -> usize {
        self.variables[position]
    }

    /// The position of a variable.
    pub fn position(&self, variable: usize) -> usize {
        self.positions[variable]
    }
}

/// The places of the upper triangle of a matrix in a new order, column by column.
pub struct Reordered {
    starts: Vec<usize>,
    entries: Vec<[u32; 2]>,
}

impl Reordered {
    pub fn of(matrix: &UpperTriangle, order: &Order) -> Self {
        let size = matrix.size();
        let all = || {
            (0..size).flat_map(|column| {
                (matrix.column_starts[column]..matrix.column_starts[column + 1]).map(move |p| (column, p))
            })
        };
        let ends = |(column, place): (usize, usize)| {
            let [a, b] = [order.position(matrix.rows[place]), order.position(column)];
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
        Self { starts, entries }
    }

    pub fn size(&self) -> usize {
        self.starts.len() - 1
    }

    /// Row in the new order and place among the values of the matrix of each entry of a column.
    pub fn column(&self, k: usize) -> &[[u32; 2]] {
        &self.entries[self.starts[k]..self.starts[k + 1]]
    }

    /// Rows of the entries of a column above its diagonal.
    fn above(&self, k: usize) -> impl Iterator<Item = usize> + '_ {
        self.column(k).iter().map(|[row, _]| *row as usize).filter(move |row| *row < k)
    }
}

/// The elimination tree of a matrix.
pub struct Tree {
    parents: Vec<Option<usize>>,
    counts: Vec<usize>,
}

impl Tree {
    /// `None` when there is no memory for it.
    pub fn of(matrix: &Reordered) -> Option<Self> {
        let size = matrix.size();
        let (mut parents, mut counts) = (room(size, None)?, room(size, 1)?);
        let mut visited = room(size, usize::MAX)?;
        for k in 0..size {
            visited[k] = k;
            for mut column in matrix.above(k) {
                while visited[column] != k {
                    visited[column] = k;
                    counts[column] += 1;
                    column = *parents[column].get_or_insert(k);
                }
            }
        }
        Some(Self { parents, counts })
    }

    /// Whether the column before this one has the rows of this one and no other.
    pub fn continues_in(&self, column: usize) -> bool {
        let before = column - 1;
        self.parents[before] == Some(column) && self.counts[before] == self.counts[column] + 1
    }
}

/// Finds the columns that have a number in a row.
pub struct Reach {
    /// The last row that asked for a column.
    visited: Vec<usize>,
    columns: Vec<usize>,
}

impl Reach {
    /// `None` when there is no memory for it.
    pub fn new(size: usize) -> Option<Self> {
        Some(Self { visited: room(size, usize::MAX)?, columns: room(size, 0)? })
    }

    /// The columns with a number in row `k` left of the diagonal, each before its parent.
    pub fn of(&mut self, k: usize, matrix: &Reordered, tree: &Tree) -> &[usize] {
        let mut top = self.columns.len();
        self.visited[k] = k;
        for row in matrix.above(k) {
            let (mut next, mut found) = (Some(row), 0);
            while let Some(column) = next.filter(|column| self.visited[*column] != k) {
                self.columns[found] = column;
                found += 1;
                self.visited[column] = k;
                next = tree.parents[column];
            }
            self.columns.copy_within(..found, top - found);
            top -= found;
        }
        &self.columns[top..]
    }
}

/// Where the numbers of a factor stand: the start of each column (one more than columns), and the row of each number,
/// ascending from the diagonal.
pub struct Places {
    pub starts: Vec<usize>,
    pub rows: Vec<usize>,
}

impl Places {
    /// With room for all rows; `None` when there is no memory for them.
    pub fn of(tree: &Tree) -> Option<Self> {
        let mut starts = vec![0];
        starts.extend(tree.counts.iter().scan(0, |end, count| {
            *end += count;
            Some(*end)
        }));
        let rows = room(tree.counts.iter().sum(), 0)?;
        Some(Self { starts, rows })
    }

    /// Adds a number; rows come one after the other, and `next` holds where each column goes on.
    pub fn add(&mut self, row: usize, column: usize, next: &mut [usize]) {
        self.rows[next[column]] = row;
        next[column] += 1;
    }
}

/// So many of a value; `None` when there is no memory for them.
pub fn room<T: Clone>(count: usize, value: T) -> Option<Vec<T>> {
    let mut values = reserved(count)?;
    values.resize(count, value);
    Some(values)
}

fn reserved<T>(count: usize) -> Option<Vec<T>> {
    let mut values = Vec::new();
    values.try_reserve_exact(count).ok()?;
    Some(values)
}

#[cfg(test)]
mod tests {
    use super::super::elimination::Elimination;
    use super::*;
    use crate::random::{Purpose, RandomSource};

    /// Numbers on the diagonal and where `there` says so above it.
    fn triangle(size: usize, there: impl Fn(usize, usize) -> bool) -> UpperTriangle {
        let mut upper = UpperTriangle { column_starts: vec![0], ..UpperTriangle::default() };
        for column in 0..size {
            upper.rows.extend((0..column).filter(|row| there(*row, column)).chain([column]));
            upper.column_starts.push(upper.rows.len());
        }
        upper.values = vec![1.0; upper.rows.len()];
        upper
    }

    #[test]
    fn the_order_of_the_published_example_is_the_published_one() {
        // can_24 of the Harwell-Boeing collection, and its order, as the authors' library has them as its demonstration.
        let above: [&[usize]; 24] = [
            &[],
            &[],
            &[],
            &[],
            &[],
            &[0],
            &[0, 2, 5],
            &[3, 4],
            &[1],
            &[1, 4, 7, 8],
            &[3],
            &[2, 6],
            &[0, 5, 6, 11],
            &[0, 1, 5, 9],
            &[1, 4, 7, 8, 9],
            &[3, 4, 7],
            &[4, 7, 15],
            &[0, 1, 5, 7, 9, 13],
            &[0, 3, 7, 9, 10, 15, 17],
            &[0, 3, 6, 10, 17, 18],
            &[2, 10, 19],
            &[0, 2, 6, 10, 11, 19, 20],
            &[2, 20, 21],
            &[6, 11, 12],
        ];
        let order = Order::of_least_degree(&triangle(24, |row, column| above[column].contains(&row))).unwrap();
        let published = [22, 20, 10, 23, 12, 5, 16, 8, 14, 4, 15, 7, 1, 9, 13, 17, 0, 2, 3, 6, 11, 18, 21, 19];
        assert_eq!(order.variables, published);
        assert!((0..24).all(|position| order.position(order.variable(position)) == position));
    }

    #[test]
    fn a_factor_has_numbers_where_elimination_makes_them_and_nowhere_else() {
        for case in 0..60_u32 {
            let stream = RandomSource::new(6).stream(Purpose::Simulation, u64::from(case));
            let size = 1 + case as usize;
            let density = f64::from(case % 5) * 0.06;
            let matrix = triangle(size, |row, column| stream.uniform(row as u32, column as u32) < density);
            for order in [Order::of_least_degree(&matrix).unwrap(), Order::as_given(size)] {
                let mut there = vec![vec![false; size]; size];
                for column in 0..size {
                    for row in &matrix.rows[matrix.column_starts[column]..matrix.column_starts[column + 1]] {
                        let [a, b] = [order.position(*row), order.position(column)];
                        (there[a][b], there[b][a]) = (true, true);
                    }
                }
                // Eliminating a variable joins all that are still there and were joined to it.
                for pivot in 0..size {
                    for a in pivot + 1..size {
                        for b in pivot + 1..size {
                            there[a][b] |= there[a][pivot] && there[pivot][b];
                        }
                    }
                }
                let elimination = Elimination::new(&matrix, &order).unwrap();
                let Places { starts, rows } = elimination.places();
                for column in 0..size {
                    let expected: Vec<usize> = (column..size).filter(|row| there[*row][column]).collect();
                    assert_eq!(rows[starts[column]..starts[column + 1]], expected, "case {case}, column {column}");
                }
            }
        }
    }

    #[test]
    fn no_memory_is_no_panic() {
        assert!(room(usize::MAX, 0.0).is_none());
        assert!(room(1 << 60, 0_usize).is_none());
        assert_eq!(room(3, 0.5), Some(vec![0.5; 3]));
    }
}

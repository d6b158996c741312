//! The sparse Cholesky factor of a precision matrix: solves with it, and draws from the Gaussian it describes.

use super::elimination::Elimination;
use super::symbolic::{room, Order, Places};
use super::triangle::UpperTriangle;
use crate::vector::vectorized;

/// Draws that are worked on side by side.
pub const LANES: usize = 16;

/// One number in all of them.
pub type Lanes = [f64; LANES];

/// P A Pᵀ = L Lᵀ with an order P that keeps L sparse.
pub struct Factor {
    order: Order,
    elimination: Elimination,
    values: Vec<f64>,
}

impl Factor {
    /// The structure of the factors of all matrices that have their numbers in the same places; `None` when there is
    /// no memory for it.
    pub fn of_structure(matrix: &UpperTriangle) -> Option<Self> {
        Self::ordered(matrix, Order::of_least_degree(matrix)?)
    }

    /// [`Self::of_structure`] that keeps the order of the variables: for a chain whose dense columns come last.
    pub fn in_order(matrix: &UpperTriangle) -> Option<Self> {
        Self::ordered(matrix, Order::as_given(matrix.size()))
    }

    fn ordered(matrix: &UpperTriangle, order: Order) -> Option<Self> {
        let elimination = Elimination::new(matrix, &order)?;
        let values = room(elimination.places().rows.len(), 0.0)?;
        Some(Self { order, elimination, values })
    }

    /// Factorises a matrix of this structure; false when it is not positive definite.
    #[must_use]
    pub fn factorize(&mut self, matrix: &UpperTriangle) -> bool {
        self.elimination.factorize(&matrix.values, &mut self.values)
    }

    /// A⁻¹ b.
    pub fn solve(&self, b: &[f64]) -> Vec<f64> {
        let mut x: Vec<[f64; 1]> = (0..b.len()).map(|i| [b[self.order.variable(i)]]).collect();
        self.forward(&mut x, 0);
        self.backward(&mut x);
        let mut solution = vec![0.0; b.len()];
        (0..b.len()).for_each(|i| solution[self.order.variable(i)] = x[i][0]);
        solution
    }

    /// Draws from N(0, A⁻¹), `N` at a time: `normal` are standard normal numbers, one row per variable of L.
    ///
    /// **Shapes:** `out` is called with each variable and its `N` draws. **Why:** Lᵀ x = n gives x the covariance
    /// (L Lᵀ)⁻¹.
    pub fn draw<const N: usize>(&self, normal: &mut [[f64; N]], mut out: impl FnMut(usize, &[f64; N])) {
        self.backward(normal);
        normal.iter().enumerate().for_each(|(i, x)| out(self.order.variable(i), x));
    }

    /// The covariance of some variables: their rows and columns of A⁻¹.
    pub fn covariance(&self, variables: &[usize]) -> Vec<Vec<f64>> {
        let positions: Vec<usize> = variables.iter().map(|v| self.order.position(*v)).collect();
        let mut covariance = vec![vec![0.0; variables.len()]; variables.len()];
        let mut x = vec![[0.0; LANES]; self.size()];
        for (block, columns) in positions.chunks(LANES).enumerate() {
            x.fill([0.0; LANES]);
            columns.iter().enumerate().for_each(|(lane, position)| x[*position][lane] = 1.0);
            self.forward(&mut x, columns.iter().copied().min().unwrap_or(0));
            self.backward(&mut x);
            for (row, position) in covariance.iter_mut().zip(&positions) {
                row[block * LANES..][..columns.len()].copy_from_slice(&x[*position][..columns.len()]);
            }
        }
        covariance
    }

    /// Multiplications of a factorisation.
    pub fn operations(&self) -> f64 {
        self.columns().map(|(rows, _)| (rows.len() * rows.len()) as f64).sum()
    }

    /// Numbers in the factor.
    pub fn numbers(&self) -> usize {
        self.values.len()
    }

    /// Number of variables.
    pub fn size(&self) -> usize {
        self.elimination.places().starts.len() - 1
    }

    /// Rows and values of a column of L, diagonal first.
    fn columns(&self) -> impl DoubleEndedIterator<Item = (&[usize], &[f64])> {
        let Places { starts, rows } = self.elimination.places();
        starts.windows(2).map(|w| (&rows[w[0]..w[1]], &self.values[w[0]..w[1]]))
    }

    /// L⁻¹ x, all lanes side by side; x is zero above the row `first`.
    fn forward<const N: usize>(&self, x: &mut [[f64; N]], first: usize) {
        vectorized(
            #[inline(always)]
            || {
                for (j, (rows, values)) in self.columns().enumerate().skip(first) {
                    let mut own = x[j];
                    for lane in 0..N {
                        own[lane] /= values[0];
                    }
                    x[j] = own;
                    for (row, value) in rows[1..].iter().zip(&values[1..]) {
                        let other = &mut x[*row];
                        for lane in 0..N {
                            other[lane] -= value * own[lane];
                        }
                    }
                }
            },
        );
    }

    /// L⁻ᵀ x, all lanes side by side.
    fn backward<const N: usize>(&self, x: &mut [[f64; N]]) {
        let n = x.len();
        vectorized(
            #[inline(always)]
            || {
                for (back, (rows, values)) in self.columns().rev().enumerate() {
                    let j = n - 1 - back;
                    let mut sum = x[j];
                    for (row, value) in rows[1..].iter().zip(&values[1..]) {
                        let other = &x[*row];
                        for lane in 0..N {
                            sum[lane] -= value * other[lane];
                        }
                    }
                    for lane in 0..N {
                        sum[lane] /= values[0];
                    }
                    x[j] = sum;
                }
            },
        );
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::{Purpose, RandomSource};

    /// A tridiagonal matrix with one far entry: 3 on the diagonal, −1 beside it and between first and last.
    fn ring(size: usize) -> (UpperTriangle, Vec<Vec<f64>>) {
        let mut dense = vec![vec![0.0; size]; size];
        let mut upper = UpperTriangle { column_starts: vec![0], ..UpperTriangle::default() };
        for c in 0..size {
            for r in 0..=c {
                let value = match c - r {
                    0 => 3.0 + 0.1 * c as f64,
                    gap if gap == 1 || gap == size - 1 => -1.0,
                    _ => continue,
                };
                (dense[r][c], dense[c][r]) = (value, value);
                upper.rows.push(r);
                upper.values.push(value);
            }
            upper.column_starts.push(upper.rows.len());
        }
        (upper, dense)
    }

    /// The entries of each column of P A Pᵀ down to the diagonal, in the order in which they stand in the matrix.
    fn columns_in_order(matrix: &UpperTriangle, order: &Order) -> Vec<Vec<(usize, f64)>> {
        let mut columns = vec![Vec::new(); matrix.size()];
        for c in 0..matrix.size() {
            for place in matrix.column_starts[c]..matrix.column_starts[c + 1] {
                let [a, b] = [order.position(matrix.rows[place]), order.position(c)];
                columns[a.max(b)].push((a.min(b), matrix.values[place]));
            }
        }
        columns
    }

    /// The columns of L, of numbers that one column after the other was subtracted from.
    ///
    /// **Source:** up-looking Cholesky as textbooks have it: row k solves a triangular system in the columns that the
    /// entries above the diagonal lead to, each of which leads to the column of its first number below the diagonal.
    fn one_by_one(matrix: &UpperTriangle, order: &Order) -> Vec<Vec<(usize, f64)>> {
        let mut factor: Vec<Vec<(usize, f64)>> = Vec::new();
        for (k, column) in columns_in_order(matrix, order).iter().enumerate() {
            let (mut row, mut reached) = (vec![0.0; k + 1], Vec::new());
            for &(entry, value) in column {
                row[entry] += value;
                let mut path: Vec<usize> = Vec::new();
                let mut next = Some(entry).filter(|entry| *entry < k);
                while let Some(at) = next.filter(|at| !reached.contains(at)) {
                    path.push(at);
                    next = factor[at].get(1).map(|(below, _)| *below).filter(|below| *below < k);
                }
                reached.splice(0..0, path);
            }
            let mut pivot = row[k];
            for j in reached {
                let own = row[j] * (1.0 / factor[j][0].1);
                factor[j][1..].iter().for_each(|(below, value)| row[*below] -= value * own);
                pivot -= own * own;
                factor[j].push((k, own));
            }
            factor.push(vec![(k, pivot.sqrt())]);
        }
        factor
    }

    /// Poses and landmarks that some of them saw; positive definite since its diagonal dominates.
    fn seen_by_chance(case: u64) -> UpperTriangle {
        let stream = RandomSource::new(4).stream(Purpose::Simulation, case);
        let chance = |a: usize, b: usize| stream.uniform(a as u32, b as u32);
        let (poses, landmarks) = (20 + 10 * case as usize, 30);
        let seen = |k: usize| (0..poses).filter(move |pose| chance(k, *pose) < 0.2).collect::<Vec<_>>().into_iter();
        let mut matrix = UpperTriangle::of_chain::<3, 3, 2>(poses, (0..landmarks).map(seen));
        for (i, value) in matrix.values.iter_mut().enumerate() {
            *value = chance(landmarks, i) - 0.5;
        }
        for (c, end) in matrix.column_starts[1..].iter().enumerate() {
            matrix.values[end - 1] = 60.0 + chance(landmarks + 1, c) + poses as f64;
        }
        matrix
    }

    #[test]
    fn columns_that_are_met_together_have_the_bits_of_one_after_the_other() {
        for case in 0..30 {
            let matrix = seen_by_chance(case);
            for structure in [Factor::of_structure, Factor::in_order] {
                let mut factor = structure(&matrix).unwrap();
                assert!(factor.factorize(&matrix));
                let expected = one_by_one(&matrix, &factor.order);
                for (j, ((rows, values), expected)) in factor.columns().zip(&expected).enumerate() {
                    let got: Vec<_> = rows.iter().zip(values).map(|(row, value)| (*row, value.to_bits())).collect();
                    let expected: Vec<_> = expected.iter().map(|(row, value)| (*row, value.to_bits())).collect();
                    assert_eq!(got, expected, "case {case}, column {j}");
                }
                assert_eq!(expected.len(), factor.size());
            }
        }
    }

    #[test]
    fn a_factor_times_its_transpose_is_the_matrix_in_its_order() {
        for case in 0..8 {
            let matrix = seen_by_chance(case);
            for structure in [Factor::of_structure, Factor::in_order] {
                let mut factor = structure(&matrix).unwrap();
                assert!(factor.factorize(&matrix));
                let size = factor.size();
                let mut product = vec![vec![0.0; size]; size];
                for (rows, values) in factor.columns() {
                    for (a, x) in rows.iter().zip(values) {
                        rows.iter().zip(values).for_each(|(b, y)| product[*a][*b] += x * y);
                    }
                }
                for (c, column) in columns_in_order(&matrix, &factor.order).iter().enumerate() {
                    column.iter().for_each(|(r, value)| product[*r][c] -= value);
                    // A sum of at most `size` products of rows whose squares sum to a diagonal below 200.
                    let bound = size as f64 * 200.0 * f64::EPSILON;
                    assert!(product[..=c].iter().all(|row| row[c].abs() < bound), "case {case}, column {c}");
                }
            }
        }
    }

    #[test]
    fn a_solution_fulfils_its_equations() {
        let (upper, dense) = ring(9);
        let mut factor = Factor::of_structure(&upper).unwrap();
        assert!(factor.factorize(&upper));
        let b: Vec<f64> = (0..9).map(|i| f64::from(i) - 3.0).collect();
        let x = factor.solve(&b);
        for (row, expected) in dense.iter().zip(&b) {
            let got: f64 = row.iter().zip(&x).map(|(a, x)| a * x).sum();
            assert!((got - expected).abs() < 1e-12, "{got} for {expected}");
        }
    }

    #[test]
    fn a_covariance_is_a_part_of_the_inverse() {
        let (upper, dense) = ring(20);
        let mut factor = Factor::of_structure(&upper).unwrap();
        assert!(factor.factorize(&upper));
        let all: Vec<usize> = (0..20).rev().collect();
        let covariance = factor.covariance(&all);
        for (r, row) in dense.iter().enumerate() {
            for c in 0..20 {
                let product: f64 = (0..20).map(|k| row[k] * covariance[19 - k][19 - c]).sum();
                assert!((product - f64::from(u8::from(r == c))).abs() < 1e-12, "({r},{c}): {product}");
            }
        }
        assert_eq!(
            factor.covariance(&[4, 17]),
            vec![vec![covariance[15][15], covariance[15][2]], vec![covariance[2][15], covariance[2][2]]]
        );
    }

    #[test]
    fn an_indefinite_matrix_is_refused() {
        let (mut upper, _) = ring(5);
        let mut factor = Factor::of_structure(&upper).unwrap();
        upper.scale_diagonal(0.1);
        assert!(!factor.factorize(&upper));
    }

    #[test]
    fn draws_have_the_inverse_as_their_covariance() {
        let (upper, dense) = ring(6);
        let mut factor = Factor::of_structure(&upper).unwrap();
        assert!(factor.factorize(&upper));
        let stream = RandomSource::new(11).stream(Purpose::Rejuvenation, 0);
        let n = 40_000_u32;
        let mut draws = vec![[0.0; 6]; n as usize];
        for (i, row) in draws.iter_mut().enumerate() {
            let mut numbers: Vec<[f64; 1]> = (0..6).map(|d| [stream.normal_pair(i as u32, d)[0]]).collect();
            factor.draw(&mut numbers, |variable, value| row[variable] = value[0]);
        }
        for (r, row) in dense.iter().enumerate() {
            let covariance = |a: usize, b: usize| draws.iter().map(|d| d[a] * d[b]).sum::<f64>() / f64::from(n);
            for c in 0..6 {
                // A times the covariance of the draws is the identity; a sample covariance here errs by less than
                // sqrt(2 / n) of a variance below 0.5, and a row of A has three numbers of which none exceeds 3.5.
                let product: f64 = (0..6).map(|k| row[k] * covariance(k, c)).sum();
                let bound = 4.0 * (2.0 / f64::from(n)).sqrt() * 0.5 * 5.5;
                assert!((product - f64::from(u8::from(r == c))).abs() < bound, "({r},{c}): {product}");
            }
        }
    }
}

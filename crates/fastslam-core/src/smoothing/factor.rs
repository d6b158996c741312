//! The sparse Cholesky factor of a precision matrix: solves with it, and draws from the Gaussian it describes.

use crate::vector::vectorized;
use faer::dyn_stack::{MemBuffer, MemStack};
use faer::sparse::linalg::cholesky::{
    factorize_symbolic_cholesky, CholeskySymbolicParams, SymbolicCholesky, SymbolicCholeskyRaw, SymmetricOrdering,
};
use faer::sparse::linalg::SupernodalThreshold;
use faer::sparse::{SparseColMatRef, SymbolicSparseColMatRef};
use faer::{Par, Side};

/// Draws that are worked on side by side.
pub const LANES: usize = 16;

/// One number in all of them.
pub type Lanes = [f64; LANES];

/// The upper triangle of a symmetric matrix, column by column.
#[derive(Clone, Debug, Default)]
pub struct UpperTriangle {
    /// Where each column starts; one more than columns.
    pub column_starts: Vec<usize>,
    /// Row of each value, ascending within a column; the last of a column is its diagonal.
    pub rows: Vec<usize>,
    /// Values.
    pub values: Vec<f64>,
}

impl UpperTriangle {
    /// The places of all numbers for a chain of poses of `P` variables, and landmarks of `D` after them: a pose's column
    /// holds the pose before and its own triangle, a landmark's column the poses that saw it, in their order, and its own
    /// triangle.
    pub fn of_chain<const P: usize, const D: usize>(
        poses: usize,
        seen_from: impl Iterator<Item = impl Iterator<Item = usize> + Clone>,
    ) -> Self {
        let mut upper = Self { column_starts: vec![0], ..Self::default() };
        for pose in 0..poses {
            for c in 0..P {
                let before = P * pose.saturating_sub(1);
                upper.rows.extend(before..P * pose + c + 1);
                upper.column_starts.push(upper.rows.len());
            }
        }
        for (landmark, seen_from) in seen_from.enumerate() {
            let own = P * poses + D * landmark;
            for c in 0..D {
                upper.rows.extend(seen_from.clone().flat_map(|pose| P * pose..P * pose + P));
                upper.rows.extend(own..own + c + 1);
                upper.column_starts.push(upper.rows.len());
            }
        }
        upper.values = vec![0.0; upper.rows.len()];
        upper
    }

    pub(super) fn size(&self) -> usize {
        self.column_starts.len() - 1
    }

    /// Multiplies the diagonal by a number.
    pub fn scale_diagonal(&mut self, factor: f64) {
        for end in &self.column_starts[1..] {
            self.values[end - 1] *= factor;
        }
    }

    fn symbolic(&self) -> SymbolicSparseColMatRef<'_, usize> {
        let n = self.size();
        SymbolicSparseColMatRef::new_checked(n, n, &self.column_starts, None, &self.rows)
    }
}

/// P A Pᵀ = L Lᵀ with an order P that keeps L sparse.
///
/// **Why:** the column-by-column factorisation, not the one with dense blocks: its arithmetic is the same on every
/// processor, and so are the bits.
pub struct Factor {
    symbolic: SymbolicCholesky<usize>,
    values: Vec<f64>,
    memory: MemBuffer,
}

impl Factor {
    /// The structure of the factors of all matrices that have their numbers in the same places; `None` when there is
    /// no memory for it.
    pub fn of_structure(matrix: &UpperTriangle) -> Option<Self> {
        Self::ordered(matrix, SymmetricOrdering::Amd)
    }

    /// [`Self::of_structure`] that keeps the order of the variables: for a chain whose dense columns come last.
    pub fn in_order(matrix: &UpperTriangle) -> Option<Self> {
        Self::ordered(matrix, SymmetricOrdering::Identity)
    }

    fn ordered(matrix: &UpperTriangle, ordering: SymmetricOrdering<'_, usize>) -> Option<Self> {
        let params = CholeskySymbolicParams {
            supernodal_flop_ratio_threshold: SupernodalThreshold::FORCE_SIMPLICIAL,
            ..CholeskySymbolicParams::default()
        };
        let symbolic = factorize_symbolic_cholesky(matrix.symbolic(), Side::Upper, ordering, params).ok()?;
        let values = vec![0.0; symbolic.len_val()];
        let scratch = symbolic.factorize_numeric_llt_scratch::<f64>(Par::Seq, faer::Spec::default());
        let memory = MemBuffer::try_new(scratch).ok()?;
        Some(Self { symbolic, values, memory })
    }

    /// Factorises a matrix of this structure; false when it is not positive definite.
    #[must_use]
    pub fn factorize(&mut self, matrix: &UpperTriangle) -> bool {
        let matrix = SparseColMatRef::new(matrix.symbolic(), matrix.values.as_slice());
        let regularization = faer::linalg::cholesky::llt::factor::LltRegularization::default();
        let (memory, spec) = (MemStack::new(&mut self.memory), faer::Spec::default());
        let factor = self.symbolic.factorize_numeric_llt(
            &mut self.values,
            matrix,
            Side::Upper,
            regularization,
            Par::Seq,
            memory,
            spec,
        );
        factor.is_ok()
    }

    /// A⁻¹ b.
    pub fn solve(&self, b: &[f64]) -> Vec<f64> {
        let mut x: Vec<[f64; 1]> = (0..b.len()).map(|i| [b[self.original(i)]]).collect();
        self.forward(&mut x, 0);
        self.backward(&mut x);
        let mut solution = vec![0.0; b.len()];
        (0..b.len()).for_each(|i| solution[self.original(i)] = x[i][0]);
        solution
    }

    /// Draws from N(0, A⁻¹), `N` at a time: `normal` are standard normal numbers, one row per variable of L.
    ///
    /// **Shapes:** `out` is called with each variable and its `N` draws. **Why:** Lᵀ x = n gives x the covariance
    /// (L Lᵀ)⁻¹.
    pub fn draw<const N: usize>(&self, normal: &mut [[f64; N]], mut out: impl FnMut(usize, &[f64; N])) {
        self.backward(normal);
        normal.iter().enumerate().for_each(|(i, x)| out(self.original(i), x));
    }

    /// The covariance of some variables: their rows and columns of A⁻¹.
    pub fn covariance(&self, variables: &[usize]) -> Vec<Vec<f64>> {
        let positions: Vec<usize> = variables.iter().map(|v| self.position(*v)).collect();
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
        self.symbolic.nrows()
    }

    /// The variable in row `i` of L.
    fn original(&self, i: usize) -> usize {
        self.symbolic.perm().map_or(i, |perm| perm.arrays().0[i])
    }

    /// The row of L that belongs to a variable.
    fn position(&self, variable: usize) -> usize {
        self.symbolic.perm().map_or(variable, |perm| perm.arrays().1[variable])
    }

    /// Rows and values of a column of L, diagonal first.
    fn columns(&self) -> impl DoubleEndedIterator<Item = (&[usize], &[f64])> {
        let (starts, rows) = match self.symbolic.raw() {
            SymbolicCholeskyRaw::Simplicial(l) => (l.col_ptr(), l.row_idx()),
            // Excluded by the parameters of the analysis.
            SymbolicCholeskyRaw::Supernodal(_) => (&[][..], &[][..]),
        };
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

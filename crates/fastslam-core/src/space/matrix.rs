//! Small matrices of any number: what [`crate::normal`] has for doubles, for particles side by side too.

use crate::real::Real;

/// `A` rows of `B` numbers.
pub type Rows<R, const A: usize, const B: usize> = [[R; B]; A];

/// a · b.
#[inline(always)]
pub fn dot<R: Real, const N: usize>(a: &[R; N], b: &[R; N]) -> R {
    let mut sum = a[0] * b[0];
    for i in 1..N {
        sum = sum + a[i] * b[i];
    }
    sum
}

/// a × b.
#[inline(always)]
pub fn cross<R: Real>(a: [R; 3], b: [R; 3]) -> [R; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// A v.
#[inline(always)]
pub fn apply<R: Real, const A: usize, const B: usize>(a: &Rows<R, A, B>, v: &[R; B]) -> [R; A] {
    let mut out = [R::constant(0.0); A];
    for i in 0..A {
        out[i] = dot(&a[i], v);
    }
    out
}

/// Aᵀ v.
#[inline(always)]
pub fn apply_transposed<R: Real, const A: usize, const B: usize>(a: &Rows<R, A, B>, v: &[R; A]) -> [R; B] {
    let mut out = [R::constant(0.0); B];
    for j in 0..B {
        let mut sum = a[0][j] * v[0];
        for i in 1..A {
            sum = sum + a[i][j] * v[i];
        }
        out[j] = sum;
    }
    out
}

/// A B.
#[inline(always)]
pub fn multiply<R: Real, const A: usize, const B: usize, const C: usize>(
    a: &Rows<R, A, B>,
    b: &Rows<R, B, C>,
) -> Rows<R, A, C> {
    let mut out = [[R::constant(0.0); C]; A];
    for i in 0..A {
        out[i] = apply_transposed(b, &a[i]);
    }
    out
}

/// A Bᵀ.
#[inline(always)]
pub fn multiply_transposed<R: Real, const A: usize, const B: usize, const C: usize>(
    a: &Rows<R, A, B>,
    b: &Rows<R, C, B>,
) -> Rows<R, A, C> {
    let mut out = [[R::constant(0.0); C]; A];
    for i in 0..A {
        out[i] = apply(b, &a[i]);
    }
    out
}

/// Aᵀ.
#[inline(always)]
pub fn transposed<R: Real, const A: usize, const B: usize>(a: &Rows<R, A, B>) -> Rows<R, B, A> {
    let mut out = [[a[0][0]; A]; B];
    for i in 0..A {
        for j in 0..B {
            out[j][i] = a[i][j];
        }
    }
    out
}

/// A of doubles, the same in all particles.
#[inline(always)]
pub fn constant<R: Real, const A: usize, const B: usize>(a: &Rows<f64, A, B>) -> Rows<R, A, B> {
    let mut out = [[R::constant(0.0); B]; A];
    for i in 0..A {
        for j in 0..B {
            out[i][j] = R::constant(a[i][j]);
        }
    }
    out
}

/// A symmetric 3×3 matrix as its upper triangle, row by row.
pub type Symmetric3<R> = [R; 6];

/// All rows of a symmetric matrix.
#[inline(always)]
pub fn full<R: Real>([xx, xy, xz, yy, yz, zz]: Symmetric3<R>) -> Rows<R, 3, 3> {
    [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]
}

/// J S Jᵀ.
#[inline(always)]
pub fn congruence3<R: Real>(j: &Rows<R, 3, 3>, s: Symmetric3<R>) -> Symmetric3<R> {
    let js = multiply(j, &full(s));
    [
        dot(&js[0], &j[0]),
        dot(&js[0], &j[1]),
        dot(&js[0], &j[2]),
        dot(&js[1], &j[1]),
        dot(&js[1], &j[2]),
        dot(&js[2], &j[2]),
    ]
}

/// The factor of a positive definite matrix, A = L Lᵀ, with the inverses of its diagonal in the diagonal's place.
///
/// Particles whose matrix is not positive definite get what is no number, which their weight shows.
#[derive(Clone, Copy, Debug)]
pub struct Triangle<R, const N: usize>(pub Rows<R, N, N>);

impl<R: Real, const N: usize> Triangle<R, N> {
    /// Of the lower triangle of a matrix.
    #[inline(always)]
    pub fn of(a: &Rows<R, N, N>) -> Self {
        let mut l = [[R::constant(0.0); N]; N];
        for i in 0..N {
            for j in 0..=i {
                let mut rest = a[i][j];
                for k in 0..j {
                    rest = rest - l[i][k] * l[j][k];
                }
                l[i][j] = if i == j { R::constant(1.0) / rest.sqrt() } else { rest * l[j][j] };
            }
        }
        Self(l)
    }

    /// L⁻¹ b.
    #[inline(always)]
    pub fn whitened(&self, b: &[R; N]) -> [R; N] {
        let mut y = *b;
        for i in 0..N {
            for k in 0..i {
                y[i] = y[i] - self.0[i][k] * y[k];
            }
            y[i] = y[i] * self.0[i][i];
        }
        y
    }

    /// L⁻¹ B.
    #[inline(always)]
    pub fn whitened_rows<const C: usize>(&self, b: &Rows<R, N, C>) -> Rows<R, N, C> {
        let mut y = *b;
        for i in 0..N {
            for c in 0..C {
                for k in 0..i {
                    y[i][c] = y[i][c] - self.0[i][k] * y[k][c];
                }
                y[i][c] = y[i][c] * self.0[i][i];
            }
        }
        y
    }

    /// L⁻ᵀ b.
    #[inline(always)]
    pub fn spread(&self, b: &[R; N]) -> [R; N] {
        let mut x = *b;
        for back in 0..N {
            let i = N - 1 - back;
            for k in i + 1..N {
                x[i] = x[i] - self.0[k][i] * x[k];
            }
            x[i] = x[i] * self.0[i][i];
        }
        x
    }

    /// The product of the inverse diagonal: 1 / √|A|.
    #[inline(always)]
    pub fn density(&self) -> R {
        let mut product = self.0[0][0];
        for i in 1..N {
            product = product * self.0[i][i];
        }
        product
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::normal;

    const S: Rows<f64, 3, 3> = [[4.0, 1.0, 0.5], [1.0, 3.0, -0.2], [0.5, -0.2, 2.0]];
    const J: Rows<f64, 3, 3> = [[1.0, 2.0, -1.0], [0.3, 0.0, 4.0], [-2.0, 1.0, 0.5]];

    #[test]
    fn products_are_those_of_doubles() {
        assert_eq!(multiply(&J, &S), normal::product(&J, &S));
        assert_eq!(multiply_transposed(&J, &transposed(&S)), normal::product(&J, &S));
        let by_rows = full(congruence3(&J, [4.0, 1.0, 0.5, 3.0, -0.2, 2.0]));
        assert_eq!(by_rows, normal::congruence(&J, &S));
        assert_eq!(apply_transposed(&J, &[1.0, 2.0, 3.0]), apply(&transposed(&J), &[1.0, 2.0, 3.0]));
        assert_eq!(cross([1.0, 2.0, 3.0], [-2.0, 0.5, 4.0]), [6.5, -10.0, 4.5]);
    }

    #[test]
    fn the_factor_whitens_and_spreads() {
        let factor = Triangle::of(&S);
        let double = normal::Cholesky::of(&S).unwrap();
        let b = [1.0, -2.0, 0.5];
        let (x, y) = (factor.spread(&factor.whitened(&b)), double.solve(&b));
        assert!((0..3).all(|i| (x[i] - y[i]).abs() < 1e-14));
        assert!((factor.density().ln() + 0.5 * double.log_determinant()).abs() < 1e-14);
        let columns = factor.whitened_rows(&transposed(&[b, [0.0, 1.0, 0.0]]));
        assert_eq!(transposed(&columns)[0], factor.whitened(&b));
        assert!(Triangle::of(&[[-1.0]]).density().is_nan());
    }
}

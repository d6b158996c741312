//! Dense matrices, as little as exact Kalman filters need: no code of the crate, and no other's that is compiled for a
//! quarter of a minute.

use std::ops::{Add, Div, Index, IndexMut, Mul, Sub};

/// Row by row; a vector is a matrix of one column.
#[derive(Clone, Debug, PartialEq)]
pub struct Matrix {
    rows: usize,
    columns: usize,
    values: Vec<f64>,
}

impl Matrix {
    pub fn zeros(rows: usize, columns: usize) -> Self {
        Self { rows, columns, values: vec![0.0; rows * columns] }
    }

    pub fn identity(size: usize) -> Self {
        Self::diagonal(&vec![1.0; size])
    }

    pub fn diagonal(values: &[f64]) -> Self {
        Self::from_fn(values.len(), values.len(), |i, j| if i == j { values[i] } else { 0.0 })
    }

    pub fn from_fn(rows: usize, columns: usize, value: impl Fn(usize, usize) -> f64) -> Self {
        Self { rows, columns, values: (0..rows * columns).map(|at| value(at / columns, at % columns)).collect() }
    }

    /// Of as many columns as the values fill.
    pub fn of_rows(rows: usize, values: &[f64]) -> Self {
        assert_eq!(values.len() % rows, 0);
        Self { rows, columns: values.len() / rows, values: values.to_vec() }
    }

    pub fn column(values: &[f64]) -> Self {
        Self::of_rows(values.len(), values)
    }

    /// Numbers in it.
    pub fn len(&self) -> usize {
        self.values.len()
    }

    /// Row by row.
    pub fn values(&self) -> &[f64] {
        &self.values
    }

    pub fn transpose(&self) -> Self {
        Self::from_fn(self.columns, self.rows, |i, j| self[(j, i)])
    }

    /// J P Jᵀ of a symmetric P, as J (J P)ᵀ: a Jacobian is mostly zeros, and those on the left cost nothing.
    pub fn transforms(&self, p: &Self) -> Self {
        self * (self * p).transpose()
    }

    /// By Gauss and Jordan with the largest pivot of each column, and the determinant.
    pub fn inverse(&self) -> (Self, f64) {
        assert_eq!(self.rows, self.columns);
        let n = self.rows;
        let (mut left, mut right, mut determinant) = (self.clone(), Self::identity(n), 1.0);
        for k in 0..n {
            let pivot = (k..n).max_by(|a, b| left[(*a, k)].abs().total_cmp(&left[(*b, k)].abs())).unwrap();
            for side in [&mut left, &mut right] {
                (0..n).for_each(|j| side.values.swap(k * n + j, pivot * n + j));
            }
            let value = left[(k, k)];
            assert!(value != 0.0, "singular");
            determinant *= if pivot == k { value } else { -value };
            for i in (0..n).filter(|i| *i != k) {
                let factor = left[(i, k)] / value;
                for side in [&mut left, &mut right] {
                    (0..n).for_each(|j| side[(i, j)] -= factor * side[(k, j)]);
                }
            }
            for side in [&mut left, &mut right] {
                (0..n).for_each(|j| side[(k, j)] /= value);
            }
        }
        (right, determinant)
    }

    fn joined(&self, other: &Self, value: impl Fn(f64, f64) -> f64) -> Self {
        assert_eq!((self.rows, self.columns), (other.rows, other.columns));
        Self::from_fn(self.rows, self.columns, |i, j| value(self[(i, j)], other[(i, j)]))
    }

    fn product(&self, other: &Self) -> Self {
        assert_eq!(self.columns, other.rows);
        let mut product = Self::zeros(self.rows, other.columns);
        for (row, sums) in self.values.chunks(self.columns).zip(product.values.chunks_mut(other.columns)) {
            for (factor, values) in row.iter().zip(other.values.chunks(other.columns)).filter(|(f, _)| **f != 0.0) {
                sums.iter_mut().zip(values).for_each(|(sum, value)| *sum += factor * value);
            }
        }
        product
    }
}

/// Row and column.
impl Index<(usize, usize)> for Matrix {
    type Output = f64;

    fn index(&self, (row, column): (usize, usize)) -> &f64 {
        &self.values[row * self.columns + column]
    }
}

impl IndexMut<(usize, usize)> for Matrix {
    fn index_mut(&mut self, (row, column): (usize, usize)) -> &mut f64 {
        &mut self.values[row * self.columns + column]
    }
}

/// Of a vector.
impl Index<usize> for Matrix {
    type Output = f64;

    fn index(&self, at: usize) -> &f64 {
        &self.values[at]
    }
}

impl IndexMut<usize> for Matrix {
    fn index_mut(&mut self, at: usize) -> &mut f64 {
        &mut self.values[at]
    }
}

/// Operators of matrices and of references to them alike.
macro_rules! operators {
    ($($left:ty, $right:ty;)*) => {$(
        impl Mul<$right> for $left {
            type Output = Matrix;

            fn mul(self, other: $right) -> Matrix {
                self.product(&other)
            }
        }

        impl Add<$right> for $left {
            type Output = Matrix;

            fn add(self, other: $right) -> Matrix {
                self.joined(&other, |a, b| a + b)
            }
        }

        impl Sub<$right> for $left {
            type Output = Matrix;

            fn sub(self, other: $right) -> Matrix {
                self.joined(&other, |a, b| a - b)
            }
        }
    )*};
}
operators! { Matrix, Matrix; Matrix, &Matrix; &Matrix, Matrix; &Matrix, &Matrix; }

impl Mul<f64> for Matrix {
    type Output = Self;

    fn mul(mut self, factor: f64) -> Self {
        self.values.iter_mut().for_each(|value| *value *= factor);
        self
    }
}

impl Div<f64> for Matrix {
    type Output = Self;

    fn div(self, divisor: f64) -> Self {
        self * (1.0 / divisor)
    }
}

#[test]
fn products_and_inverses_are_those_worked_out_by_hand() {
    let (a, b) =
        (Matrix::of_rows(2, &[1.0, 2.0, 3.0, 4.0, 5.0, 6.0]), Matrix::of_rows(3, &[1.0, -1.0, 2.0, 0.0, 3.0, 4.0]));
    assert_eq!(&a * &b, Matrix::of_rows(2, &[14.0, 11.0, 32.0, 20.0]));
    assert_eq!(a.transpose(), Matrix::of_rows(3, &[1.0, 4.0, 2.0, 5.0, 3.0, 6.0]));
    assert_eq!(&a + b.transpose(), Matrix::of_rows(2, &[2.0, 4.0, 6.0, 3.0, 5.0, 10.0]));
    assert_eq!(a.transforms(&Matrix::identity(3)), &a * a.transpose());
    // Its first pivot is zero, and rows are exchanged once.
    let (inverse, determinant) = Matrix::of_rows(3, &[0.0, 2.0, 1.0, 4.0, 0.0, 0.0, 0.0, 0.0, 8.0]).inverse();
    assert_eq!((inverse.values(), determinant), (&[0.0, 0.25, 0.0, 0.5, 0.0, -0.0625, 0.0, 0.0, 0.125][..], -64.0));
}

//! The joint covariance: symmetric tiles with a list of rank-one corrections that are applied many at a time.
//!
//! A sighting subtracts two outer products from a matrix of K² numbers. Subtracting them one sighting at a time is
//! bound by memory; here the vectors are kept, counted in whenever an element is read, and subtracted together in one
//! pass over the tiles, so that the work is bound by arithmetic. The result is that of the plain update to rounding.

use crate::geometry::{transform3, Matrix3};
use crate::vector::vectorized;
use serde::{Deserialize, Serialize};

/// Rows and columns of a tile.
pub const TILE: usize = 8;
const AREA: usize = TILE * TILE;
/// Rows of the pose.
const POSE: usize = 3;
/// Vectors that are kept before they are subtracted. Reading a column costs this many times its length.
const MOST_PENDING: usize = 32;

/// A symmetric matrix A = T − W Wᵀ that grows: T as the tiles of its lower triangle, W as pending vectors.
///
/// Rows past those in use are zero in T and W. The first three are the pose.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Covariance {
    /// Rows of tiles.
    blocks: usize,
    /// Tile (I, J), J ≤ I, at I (I + 1) / 2 + J, in row order; those on the diagonal are whole.
    tiles: Vec<f64>,
    /// Element a of block I of vector c at (I · MOST_PENDING + c) · TILE + a.
    vectors: Vec<f64>,
    pending: usize,
    /// No part of the matrix: of no use between two scans.
    #[serde(skip)]
    before: Before,
}

/// What takes a matrix back to where it was: the parts that are changed in place, and the tiles and vectors of before
/// the first subtraction since then.
#[derive(Clone, Debug, Default)]
struct Before {
    blocks: usize,
    pending: usize,
    /// The numbers of the pose in the first tile of each row of tiles.
    pose: Vec<f64>,
    first_tile: Vec<f64>,
    first_vectors: Vec<f64>,
    tiles: Vec<f64>,
    vectors: Vec<f64>,
    is_subtracted: bool,
}

/// A 2 × n matrix H that is zero but in five columns.
#[derive(Clone, Copy, Debug)]
pub struct SparseRows {
    /// Columns: three of the pose and two of the landmark.
    pub columns: [usize; 5],
    /// Values.
    pub values: [[f64; 5]; 2],
}

/// Two vectors of the matrix' size: element a of block I of vector c at (2 I + c) · TILE + a.
pub type VectorPair = Vec<f64>;

impl Covariance {
    /// Zero, with room for the pose.
    pub fn new() -> Self {
        let (tiles, vectors) = (vec![0.0; AREA], vec![0.0; MOST_PENDING * TILE]);
        Self { blocks: 1, tiles, vectors, pending: 0, before: Before::default() }
    }

    /// Numbers held, those of the state to go back to among them, in bytes.
    pub fn bytes(&self) -> usize {
        let Before { pose, tiles, vectors, .. } = &self.before;
        (self.tiles.len() + self.vectors.len() + pose.len() + tiles.len() + vectors.len()) * size_of::<f64>()
    }

    /// Takes note of the matrix as it is, for [`Covariance::go_back`]. Costs as much as a few of its rows.
    pub fn remember(&mut self) {
        let Self { blocks, tiles, vectors, pending, before } = self;
        (before.blocks, before.pending, before.is_subtracted) = (*blocks, *pending, false);
        before.pose.clear();
        for block in 0..*blocks {
            let first = block * (block + 1) / 2 * AREA;
            before.pose.extend(tiles[first..first + AREA].chunks_exact(TILE).flat_map(|row| &row[..POSE]));
        }
        before.first_tile.clear();
        before.first_tile.extend_from_slice(&tiles[..AREA]);
        before.first_vectors.clear();
        before.first_vectors.extend_from_slice(&vectors[..MOST_PENDING * TILE]);
    }

    /// Makes the matrix, to the last bit, what it was when it was last remembered; it had `rows` rows in use then.
    pub fn go_back(&mut self, rows: usize) {
        let Self { blocks, tiles, vectors, pending, before } = self;
        if before.is_subtracted {
            std::mem::swap(tiles, &mut before.tiles);
            std::mem::swap(vectors, &mut before.vectors);
            before.is_subtracted = false;
        }
        (*blocks, *pending) = (before.blocks, before.pending);
        tiles.truncate(*blocks * (*blocks + 1) / 2 * AREA);
        vectors.truncate(*blocks * MOST_PENDING * TILE);
        for (block, kept) in before.pose.chunks_exact(POSE * TILE).enumerate() {
            let first = block * (block + 1) / 2 * AREA;
            for (row, kept) in tiles[first..first + AREA].chunks_exact_mut(TILE).zip(kept.chunks_exact(POSE)) {
                row[..POSE].copy_from_slice(kept);
            }
        }
        tiles[..AREA].copy_from_slice(&before.first_tile);
        vectors[..MOST_PENDING * TILE].copy_from_slice(&before.first_vectors);
        for row in rows..self.blocks * TILE {
            (0..self.blocks * TILE).for_each(|column| self.set(row, column, 0.0));
        }
    }

    /// Grows by rows and columns of zeros until there are at least `rows`.
    pub fn reserve_rows(&mut self, rows: usize) {
        while self.blocks * TILE < rows {
            self.blocks += 1;
            self.tiles.resize(self.blocks * (self.blocks + 1) / 2 * AREA, 0.0);
            self.vectors.resize(self.blocks * MOST_PENDING * TILE, 0.0);
        }
    }

    fn position(row: usize, column: usize) -> usize {
        let (row, column) = (row.max(column), row.min(column));
        let (i, j) = (row / TILE, column / TILE);
        (i * (i + 1) / 2 + j) * AREA + (row % TILE) * TILE + column % TILE
    }

    fn vector(&self, row: usize) -> impl Iterator<Item = f64> + '_ {
        let first = row / TILE * MOST_PENDING * TILE + row % TILE;
        (0..self.pending).map(move |c| self.vectors[first + c * TILE])
    }

    /// One element.
    pub fn get(&self, row: usize, column: usize) -> f64 {
        let kept: f64 = self.vector(row).zip(self.vector(column)).map(|(a, b)| a * b).sum();
        self.tiles[Self::position(row, column)] - kept
    }

    /// H A Hᵀ.
    pub fn projected(&self, h: &SparseRows) -> [[f64; 2]; 2] {
        let a: [[f64; 5]; 5] = std::array::from_fn(|i| {
            std::array::from_fn(|j| if j <= i { self.get(h.columns[i], h.columns[j]) } else { 0.0 })
        });
        let at = |i: usize, j: usize| if j <= i { a[i][j] } else { a[j][i] };
        let dot = |x: usize, y: usize| -> f64 {
            (0..5).map(|i| h.values[x][i] * (0..5).map(|j| at(i, j) * h.values[y][j]).sum::<f64>()).sum()
        };
        let mixed = dot(0, 1);
        [[dot(0, 0), mixed], [mixed, dot(1, 1)]]
    }

    /// A Hᵀ.
    pub fn times_transposed(&self, h: &SparseRows, out: &mut VectorPair) {
        let mut folded = [[0.0; 2]; MOST_PENDING];
        for (s, &column) in h.columns.iter().enumerate() {
            for (c, w) in self.vector(column).enumerate() {
                (0..2).for_each(|r| folded[c][r] += h.values[r][s] * w);
            }
        }
        out.clear();
        out.resize(self.blocks * 2 * TILE, 0.0);
        for (block, pair) in out.chunks_exact_mut(2 * TILE).enumerate() {
            for (s, &column) in h.columns.iter().enumerate() {
                let values = self.column_of_block(block, column);
                for a in 0..TILE {
                    pair[a] += h.values[0][s] * values[a];
                    pair[TILE + a] += h.values[1][s] * values[a];
                }
            }
            let vectors = &self.vectors[block * MOST_PENDING * TILE..][..self.pending * TILE];
            for (w, f) in vectors.chunks_exact(TILE).zip(&folded) {
                for a in 0..TILE {
                    pair[a] -= w[a] * f[0];
                    pair[TILE + a] -= w[a] * f[1];
                }
            }
        }
    }

    /// Eight elements of a column of T.
    fn column_of_block(&self, block: usize, column: usize) -> [f64; TILE] {
        let (other, inside) = (column / TILE, column % TILE);
        if block >= other {
            let tile = &self.tiles[(block * (block + 1) / 2 + other) * AREA..][..AREA];
            std::array::from_fn(|a| tile[a * TILE + inside])
        } else {
            let row = (other * (other + 1) / 2 + block) * AREA + inside * TILE;
            std::array::from_fn(|a| self.tiles[row + a])
        }
    }

    /// A ← A − w₀ w₀ᵀ − w₁ w₁ᵀ.
    pub fn subtract_outer(&mut self, pair: &VectorPair) {
        for (block, values) in pair.chunks_exact(2 * TILE).enumerate() {
            let first = (block * MOST_PENDING + self.pending) * TILE;
            self.vectors[first..first + 2 * TILE].copy_from_slice(values);
        }
        self.pending += 2;
        if self.pending == MOST_PENDING {
            self.subtract_pending();
        }
    }

    /// T ← T − W Wᵀ. The first time since the matrix was remembered, its tiles and vectors are kept.
    fn subtract_pending(&mut self) {
        let Self { tiles, vectors, before, .. } = self;
        if before.is_subtracted {
            vectorized(|| subtract_all(tiles, vectors));
            vectors.fill(0.0);
        } else {
            before.tiles.resize(tiles.len(), 0.0);
            let kept = &mut before.tiles;
            vectorized(|| subtract_all_into(kept, tiles, vectors));
            std::mem::swap(tiles, kept);
            before.vectors.clear();
            before.vectors.resize(vectors.len(), 0.0);
            std::mem::swap(vectors, &mut before.vectors);
            before.is_subtracted = true;
        }
        self.pending = 0;
    }

    /// The pose s becomes f(s) + noise: rows and columns of the pose times F = ∂f/∂s, plus the noise's covariance.
    pub fn move_pose(&mut self, f: &Matrix3, noise: &Matrix3) {
        let pose: Matrix3 = std::array::from_fn(|i| std::array::from_fn(|j| self.tiles[Self::position(i, j)]));
        for block in 0..self.blocks {
            let first = block * (block + 1) / 2 * AREA;
            for row in self.tiles[first..first + AREA].chunks_exact_mut(TILE) {
                turn(f, row);
            }
        }
        let moved = transform3(f, &pose);
        for i in 0..3 {
            for j in 0..3 {
                self.tiles[i * TILE + j] = 0.5 * (moved[i][j] + moved[j][i]) + noise[i][j];
            }
            for j in 3..TILE {
                self.tiles[i * TILE + j] = self.tiles[j * TILE + i];
            }
        }
        for w in self.vectors[..self.pending * TILE].chunks_exact_mut(TILE) {
            turn(f, w);
        }
    }

    /// Rows `first` and `first + 1`, so far zero, become those of a new landmark J s + noise, s the pose.
    pub fn add_landmark(&mut self, first: usize, j: &[[f64; 3]; 2], noise: [[f64; 2]; 2]) {
        self.reserve_rows(first + 2);
        let mut cross = VectorPair::new();
        let rows = SparseRows { columns: [0, 1, 2, 3, 3], values: j.map(|[x, y, heading]| [x, y, heading, 0.0, 0.0]) };
        self.times_transposed(&rows, &mut cross);
        let own = self.projected(&rows);
        for index in 0..first {
            for r in 0..2 {
                let value = cross[(index / TILE * 2 + r) * TILE + index % TILE];
                self.set(first + r, index, value);
            }
        }
        for r in 0..2 {
            for c in 0..2 {
                self.set(first + r, first + c, own[r][c] + noise[r][c]);
            }
        }
    }

    fn set(&mut self, row: usize, column: usize, value: f64) {
        self.tiles[Self::position(row, column)] = value;
        if row / TILE == column / TILE {
            let first = (row / TILE) * (row / TILE + 1) / 2 + row / TILE;
            self.tiles[first * AREA + (column % TILE) * TILE + row % TILE] = value;
        }
    }

    /// The pose's own block.
    pub fn of_pose(&self) -> Matrix3 {
        std::array::from_fn(|i| std::array::from_fn(|j| self.get(i.max(j), i.min(j))))
    }
}

impl Default for Covariance {
    fn default() -> Self {
        Self::new()
    }
}

/// The first three numbers of a row times Fᵀ.
fn turn(f: &Matrix3, row: &mut [f64]) {
    let old = [row[0], row[1], row[2]];
    for i in 0..3 {
        row[i] = f[i][0] * old[0] + f[i][1] * old[1] + f[i][2] * old[2];
    }
}

/// T ← T − W Wᵀ, tile by tile, with all vectors.
#[inline(always)]
fn subtract_all(tiles: &mut [f64], vectors: &[f64]) {
    let length = MOST_PENDING * TILE;
    let mut tiles = tiles.chunks_exact_mut(AREA);
    for (block, left) in vectors.chunks_exact(length).enumerate() {
        for right in vectors.chunks_exact(length).take(block + 1) {
            let Some(tile) = tiles.next() else { return };
            tile.copy_from_slice(&subtracted(tile, left, right));
        }
    }
}

/// The same into other tiles.
#[inline(always)]
fn subtract_all_into(into: &mut [f64], tiles: &[f64], vectors: &[f64]) {
    let length = MOST_PENDING * TILE;
    let mut tiles = tiles.chunks_exact(AREA).zip(into.chunks_exact_mut(AREA));
    for (block, left) in vectors.chunks_exact(length).enumerate() {
        for right in vectors.chunks_exact(length).take(block + 1) {
            let Some((tile, into)) = tiles.next() else { return };
            into.copy_from_slice(&subtracted(tile, left, right));
        }
    }
}

/// One tile of T − W Wᵀ.
#[inline(always)]
fn subtracted(tile: &[f64], left: &[f64], right: &[f64]) -> [f64; AREA] {
    let mut sum: [f64; AREA] = std::array::from_fn(|i| tile[i]);
    for (l, r) in left.chunks_exact(TILE).zip(right.chunks_exact(TILE)) {
        for a in 0..TILE {
            for b in 0..TILE {
                sum[a * TILE + b] -= l[a] * r[b];
            }
        }
    }
    sum
}

//! Threads that share the particles among them.

use crate::error::{Error, Result};
use rayon::ThreadPool;
use std::sync::{Arc, Mutex, PoisonError};

/// Particles of a part of a pass: a thread has more to do with them than to be told of them.
pub const PART: usize = 4096;

/// Something with an equal share for every particle that can be cut between two particles.
pub trait Divide: Sized + Send {
    /// Number of particles.
    fn count(&self) -> usize;
    /// The first `at` particles, and the others.
    fn divide(self, at: usize) -> (Self, Self);
}

impl<T: Send> Divide for &mut [T] {
    fn count(&self) -> usize {
        self.len()
    }

    fn divide(self, at: usize) -> (Self, Self) {
        self.split_at_mut(at)
    }
}

/// Columns of equal length.
impl<'a, T: Send, const N: usize> Divide for [&'a mut [T]; N] {
    fn count(&self) -> usize {
        self.first().map_or(0, |column| column.len())
    }

    fn divide(mut self, at: usize) -> (Self, Self) {
        let head: [&'a mut [T]; N] = self.each_mut().map(|column| {
            let (head, tail) = std::mem::take(column).split_at_mut(at);
            *column = tail;
            head
        });
        (head, self)
    }
}

/// Several entries for every particle, one particle after the other.
#[derive(Debug)]
pub struct Shares<'a, T> {
    /// The entries of all particles.
    pub entries: &'a mut [T],
    /// Entries per particle; at least one.
    pub each: usize,
}

impl<T: Send> Divide for Shares<'_, T> {
    fn count(&self) -> usize {
        self.entries.len() / self.each
    }

    fn divide(self, at: usize) -> (Self, Self) {
        let (head, tail) = self.entries.split_at_mut(at * self.each);
        (Self { entries: head, each: self.each }, Self { entries: tail, each: self.each })
    }
}

impl<A: Divide, B: Divide> Divide for (A, B) {
    fn count(&self) -> usize {
        self.0.count()
    }

    fn divide(self, at: usize) -> (Self, Self) {
        let ((a, c), (b, d)) = (self.0.divide(at), self.1.divide(at));
        ((a, b), (c, d))
    }
}

impl<A: Divide, B: Divide, C: Divide> Divide for (A, B, C) {
    fn count(&self) -> usize {
        self.0.count()
    }

    fn divide(self, at: usize) -> (Self, Self) {
        let ((a, d), (b, e), (c, f)) = (self.0.divide(at), self.1.divide(at), self.2.divide(at));
        ((a, b, c), (d, e, f))
    }
}

/// The threads of a filter; the calling thread alone when one is enough.
#[derive(Clone, Debug, Default)]
pub struct Workers {
    pool: Option<Arc<ThreadPool>>,
}

impl Workers {
    /// So many threads.
    ///
    /// **Errors:** when the system refuses that many.
    pub fn new(threads: u32) -> Result<Self> {
        if threads < 2 {
            return Ok(Self::default());
        }
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads as usize).build();
        let refused = |error| Error::parameter("filter.threads", threads, format!("fewer: {error}"));
        Ok(Self { pool: Some(Arc::new(pool.map_err(refused)?)) })
    }

    /// Number of threads.
    pub fn count(&self) -> usize {
        self.pool.as_ref().map_or(1, |pool| pool.current_num_threads())
    }

    /// Calls `work` once for every `part` particles (the last may be fewer), with the number of the first of them.
    ///
    /// **Why parts of a fixed size:** who does what depends on the number of threads; what is done does not.
    pub fn share<D: Divide>(&self, whole: D, part: usize, work: &(impl Fn(usize, D) + Sync)) {
        match &self.pool {
            Some(pool) if whole.count() > part => pool.install(|| halve(0, whole, part, work)),
            _ => one_by_one(whole, part, work),
        }
    }

    /// Does two things that have nothing to do with each other, at the same time if there are enough particles.
    pub fn both(&self, particles: usize, a: impl FnOnce() + Send, b: impl FnOnce() + Send) {
        match &self.pool {
            Some(pool) if particles > PART => drop(pool.join(a, b)),
            _ => {
                a();
                b();
            }
        }
    }
}

fn one_by_one<D: Divide>(whole: D, part: usize, work: &impl Fn(usize, D)) {
    let (mut first, mut rest) = (0, whole);
    while rest.count() > part {
        let (head, tail) = rest.divide(part);
        work(first, head);
        (first, rest) = (first + part, tail);
    }
    work(first, rest);
}

fn halve<D: Divide>(first: usize, whole: D, part: usize, work: &(impl Fn(usize, D) + Sync)) {
    let parts = whole.count().div_ceil(part);
    if parts < 2 {
        return work(first, whole);
    }
    let middle = parts / 2 * part;
    let (head, tail) = whole.divide(middle);
    rayon::join(|| halve(first, head, part, work), || halve(first + middle, tail, part, work));
}

/// A value for each thread.
#[derive(Debug, Default)]
pub struct PerThread<T> {
    values: Vec<Mutex<T>>,
}

impl<T: Default> PerThread<T> {
    /// One for each of these threads.
    pub fn new(workers: &Workers) -> Self {
        Self { values: (0..workers.count()).map(|_| Mutex::default()).collect() }
    }

    /// Lends the value of the calling thread.
    pub fn with<R>(&self, work: impl FnOnce(&mut T) -> R) -> R {
        let index = rayon::current_thread_index().unwrap_or(0) % self.values.len().max(1);
        match self.values.get(index) {
            Some(value) => work(&mut value.lock().unwrap_or_else(PoisonError::into_inner)),
            None => work(&mut T::default()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_particle_is_worked_on_once_whoever_does_it() {
        for threads in [1, 2, 5] {
            let workers = Workers::new(threads).unwrap();
            for count in [0, 1, 9, 10, 11, 95, 100] {
                let (mut values, mut pairs) = (vec![0; count], vec![0; 2 * count]);
                let (mut a, mut b) = (vec![0; count], vec![0; count]);
                let whole = (&mut values[..], Shares { entries: &mut pairs, each: 2 }, [&mut a[..], &mut b[..]]);
                workers.share(whole, 10, &|first, (values, pairs, [a, b])| {
                    assert_eq!((first % 10, pairs.count(), a.len()), (0, values.len(), values.len()));
                    assert!(values.len() <= 10);
                    for i in 0..values.len() {
                        values[i] += first + i;
                        pairs.entries[2 * i + 1] += first + i;
                        (a[i], b[i]) = (a[i] + first + i, b[i] + 1);
                    }
                });
                let expected: Vec<usize> = (0..count).collect();
                assert_eq!((&values, &a, b), (&expected, &expected, vec![1; count]));
                assert_eq!(pairs, expected.iter().flat_map(|i| [0, *i]).collect::<Vec<_>>());
            }
        }
    }

    #[test]
    fn both_are_done_whoever_does_them() {
        for (threads, particles) in [(1, 9 * PART), (2, 10), (2, 9 * PART)] {
            let (mut a, mut b) = (0, 0);
            Workers::new(threads).unwrap().both(particles, || a += 1, || b += 2);
            assert_eq!((a, b), (1, 2));
        }
    }

    #[test]
    fn each_thread_has_a_value_of_its_own() {
        let workers = Workers::new(3).unwrap();
        let counts = PerThread::<usize>::new(&workers);
        workers.share(&mut [0_u8; 1000][..], 1, &|_, part| counts.with(|count| *count += part.len()));
        let total: usize = counts.values.iter().map(|count| *count.lock().unwrap()).sum();
        assert_eq!((counts.values.len(), total), (3, 1000));
    }
}

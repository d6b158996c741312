//! Storage for many small arrays whose lengths change: size classes on pages, without a heap allocation in the steady
//! state and with fully free pages given back.

use serde::{Deserialize, Serialize};
/// Elements per page; an array longer than that has a page of its own.
const PAGE: usize = 4096;
/// Lengths up to this one have a class each; above, four classes per doubling (at most a quarter unused).
const EXACT: usize = 8;
/// Pages' worth of free places that a class keeps in any case.
const SLACK: usize = 8;

/// Where an array lies.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Place {
    page: u32,
    offset: u32,
}

impl Place {
    /// A place that means nothing.
    pub(super) const EMPTY: Self = Self { page: 0, offset: 0 };
}

/// A pool of arrays of `T`. The caller remembers the length of each.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(super) struct Arena<T> {
    pages: Vec<Page<T>>,
    /// Pages that were given back; their numbers may be used again.
    vacant: Vec<u32>,
    classes: Vec<Class>,
    elements: usize,
}

#[derive(Clone, Debug, Serialize, Deserialize)]
struct Page<T> {
    values: Box<[T]>,
    /// Offsets from this one on were never handed out.
    untouched: u32,
    /// Places that were handed out and came back, counted from the start of the page. At most `PAGE`.
    returned: Vec<u16>,
    live: u32,
    /// Position among the open pages of its class; meaningless while the page is full.
    position: u32,
}

#[derive(Clone, Debug, Default, Serialize, Deserialize)]
struct Class {
    /// Pages with a free place, those without a live array first.
    open: Vec<u32>,
    empty: usize,
    live: usize,
    places: usize,
}

/// Number of the class that holds arrays of `length`, and the length it reserves.
fn class_of(length: usize) -> (usize, usize) {
    if length <= EXACT {
        return (length, length.max(1));
    }
    let doubling = (length - 1).ilog2();
    let step = 1 << (doubling - 2);
    let steps = length.div_ceil(step);
    // `steps` runs from 5 to 8, and the first doubling is that of 9..=16.
    (EXACT + 4 * (doubling as usize - 3) + steps - 4, steps * step)
}

/// Arrays on a page of the class that reserves `size` elements.
fn per_page(size: usize) -> usize {
    (PAGE / size).max(1)
}

impl<T: Copy + Default> Arena<T> {
    /// Room for `length` elements, whose values are unspecified.
    pub(super) fn allocate(&mut self, length: usize) -> Place {
        let (number, size) = class_of(length);
        if number >= self.classes.len() {
            self.classes.resize_with(number + 1, Class::default);
        }
        let number_of_page = match self.classes[number].open.last() {
            Some(&page) => page,
            None => self.add_page(number, size),
        };
        let page = &mut self.pages[number_of_page as usize];
        let offset = match page.returned.pop() {
            Some(place) => u32::from(place) * size as u32,
            None => {
                page.untouched += size as u32;
                page.untouched - size as u32
            }
        };
        page.live += 1;
        let class = &mut self.classes[number];
        class.live += 1;
        class.empty = class.empty.min(class.open.len() - 1);
        if page.returned.is_empty() && page.untouched as usize + size > page.values.len() {
            class.open.pop();
        }
        Place { page: number_of_page, offset }
    }

    /// Gives back an array of `length` elements.
    pub(super) fn free(&mut self, place: Place, length: usize) {
        let (number, size) = class_of(length);
        let class = &mut self.classes[number];
        let page = &mut self.pages[place.page as usize];
        if page.returned.is_empty() && page.untouched as usize + size > page.values.len() {
            page.position = class.open.len() as u32;
            class.open.push(place.page);
        }
        if page.returned.capacity() == 0 {
            page.returned.reserve_exact(per_page(size));
        }
        page.returned.push((place.offset / size as u32) as u16);
        page.live -= 1;
        class.live -= 1;
        if page.live == 0 {
            let position = page.position as usize;
            self.exchange_open(number, position, self.classes[number].empty);
            self.classes[number].empty += 1;
        }
        // As many free places as live ones, and some, let the population breathe without a heap allocation. Two pages
        // at a time keep up with any caller.
        for _ in 0..2 {
            let class = &self.classes[number];
            if class.empty > 0 && class.places - class.live > class.live + SLACK * per_page(size) {
                self.release_empty_page(number, size);
            }
        }
    }

    /// The `length` elements at `place`.
    pub(super) fn get(&self, place: Place, length: usize) -> &[T] {
        &self.pages[place.page as usize].values[place.offset as usize..][..length]
    }

    /// The `length` elements at `place`, to be changed.
    pub(super) fn get_mut(&mut self, place: Place, length: usize) -> &mut [T] {
        &mut self.pages[place.page as usize].values[place.offset as usize..][..length]
    }

    /// One array to read and another one to write.
    pub(super) fn pair(&mut self, from: (Place, usize), to: (Place, usize)) -> (&[T], &mut [T]) {
        let ((from, from_length), (to, to_length)) = (from, to);
        let (from_offset, to_offset) = (from.offset as usize, to.offset as usize);
        if from.page == to.page {
            let values = &mut self.pages[from.page as usize].values;
            if from_offset < to_offset {
                let (head, tail) = values.split_at_mut(to_offset);
                return (&head[from_offset..][..from_length], &mut tail[..to_length]);
            }
            let (head, tail) = values.split_at_mut(from_offset);
            return (&tail[..from_length], &mut head[to_offset..][..to_length]);
        }
        let middle = from.page.max(to.page) as usize;
        let (head, tail) = self.pages.split_at_mut(middle);
        let (source, target) = if from.page < to.page {
            (&mut head[from.page as usize], &mut tail[0])
        } else {
            (&mut tail[0], &mut head[to.page as usize])
        };
        (&source.values[from_offset..][..from_length], &mut target.values[to_offset..][..to_length])
    }

    /// Bytes of the pages and of what is needed to find a place on them.
    pub(super) fn bytes(&self) -> usize {
        let lists: usize = self.pages.iter().map(|page| page.returned.capacity()).sum();
        let open: usize = self.classes.iter().map(|class| class.open.capacity()).sum();
        self.elements * size_of::<T>()
            + self.pages.capacity() * size_of::<Page<T>>()
            + self.classes.capacity() * size_of::<Class>()
            + lists * size_of::<u16>()
            + (open + self.vacant.capacity()) * size_of::<u32>()
    }

    fn add_page(&mut self, number: usize, size: usize) -> u32 {
        let per_page = per_page(size);
        let class = &mut self.classes[number];
        let page = Page {
            values: vec![T::default(); per_page * size].into_boxed_slice(),
            untouched: 0,
            returned: Vec::new(),
            live: 0,
            position: class.open.len() as u32,
        };
        class.places += per_page;
        self.elements += page.values.len();
        let index = match self.vacant.pop() {
            Some(index) => {
                self.pages[index as usize] = page;
                index
            }
            None => {
                self.pages.push(page);
                (self.pages.len() - 1) as u32
            }
        };
        class.open.push(index);
        index
    }

    fn release_empty_page(&mut self, number: usize, size: usize) {
        let last_empty = self.classes[number].empty - 1;
        self.exchange_open(number, last_empty, self.classes[number].open.len() - 1);
        let class = &mut self.classes[number];
        class.empty -= 1;
        class.places -= per_page(size);
        if let Some(index) = class.open.pop() {
            let page = &mut self.pages[index as usize];
            self.elements -= page.values.len();
            page.values = Box::default();
            page.returned = Vec::new();
            self.vacant.push(index);
        }
    }

    fn exchange_open(&mut self, number: usize, i: usize, j: usize) {
        let open = &mut self.classes[number].open;
        open.swap(i, j);
        self.pages[open[i] as usize].position = i as u32;
        self.pages[open[j] as usize].position = j as u32;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::{Purpose, RandomSource};

    #[test]
    fn classes_hold_their_lengths_and_waste_at_most_a_quarter() {
        let mut last = (0, 0);
        for length in 1..5000 {
            let (number, size) = class_of(length);
            assert!(size >= length && size <= length + length / 4, "{length} in {size}");
            assert!((number, size) == last || (number == last.0 + 1 && size > last.1), "{length}: a class per size");
            last = (number, size);
        }
        assert_eq!((class_of(0).1, class_of(1250).1, class_of(9).1), (1, 1280, 10));
    }

    #[test]
    fn arrays_keep_their_values_and_pages_come_back() {
        let mut arena = Arena::<u32>::default();
        let mut held: Vec<(Place, Vec<u32>)> = Vec::new();
        let stream = RandomSource::new(5).stream(Purpose::Simulation, 0);
        let mut compared = 0;
        for round in 0..20_000_u32 {
            let draw = (stream.uniform(round, 0) * 1e6) as u32;
            if round % 10_000 < 6_000 && !draw.is_multiple_of(3) {
                let length = 1 + (draw % 700) as usize * usize::from(draw.is_multiple_of(5)) + (draw % 7) as usize;
                let place = arena.allocate(length);
                arena.get_mut(place, length).fill(round);
                held.push((place, vec![round; length]));
            } else if !held.is_empty() {
                let (place, values) = held.swap_remove(draw as usize % held.len());
                assert_eq!(arena.get(place, values.len()), values);
                arena.free(place, values.len());
                compared += 1;
            }
        }
        assert!(compared > 5_000);
        let full = arena.elements;
        for (place, values) in held.drain(..) {
            assert_eq!(arena.get(place, values.len()), values);
            arena.free(place, values.len());
        }
        assert!(arena.classes.iter().all(|class| class.live == 0));
        assert!(arena.elements <= full, "nothing grows by freeing");
        // A burst of large arrays is given back but for the slack.
        let places: Vec<Place> = (0..1000).map(|_| arena.allocate(3000)).collect();
        let peak = arena.elements;
        places.into_iter().for_each(|place| arena.free(place, 3000));
        assert!(arena.elements < peak / 10, "{} of {peak} left", arena.elements);
    }

    #[test]
    fn pairs_are_the_two_arrays_on_one_page_and_on_two() {
        let mut arena = Arena::<f64>::default();
        let places: Vec<Place> = (0..1100).map(|_| arena.allocate(4)).collect();
        let ends = [places[0], places[1], places[1099]];
        assert!(ends[0].page == ends[1].page && ends[0].page != ends[2].page);
        for (i, place) in ends.into_iter().enumerate() {
            arena.get_mut(place, 4).fill(i as f64);
        }
        for (i, j) in [(0, 1), (1, 0), (0, 2), (2, 0)] {
            let (source, target) = arena.pair((ends[i], 4), (ends[j], 3));
            assert_eq!((source, target.to_vec()), (&[i as f64; 4][..], vec![j as f64; 3]));
        }
    }
}

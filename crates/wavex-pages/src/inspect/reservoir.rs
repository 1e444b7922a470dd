//! Evenly spaced selection from a sequence.

/// Every n-th item of a sequence of unknown length, from the first: between `most / 2` and `most`
/// items.
#[derive(Clone, Debug)]
pub struct Thinned<T> {
    items: Vec<T>,
    most: usize,
    stride: u64,
    seen: u64,
}

impl<T> Thinned<T> {
    /// Keeps at most `most` items, rounded up to an even number.
    pub fn new(most: usize) -> Thinned<T> {
        Thinned { items: Vec::new(), most: most.max(2).next_multiple_of(2), stride: 1, seen: 0 }
    }

    /// Offers the next item, which is created only if kept.
    pub fn add(&mut self, make: impl FnOnce() -> T) {
        if self.seen.is_multiple_of(self.stride) {
            if self.items.len() == self.most {
                let mut index = 0;
                self.items.retain(|_| {
                    index += 1;
                    index % 2 == 1
                });
                self.stride *= 2;
            }
            self.items.push(make());
        }
        self.seen += 1;
    }

    /// The kept items, in order.
    pub fn items(&self) -> &[T] {
        &self.items
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_kept_is_spread_evenly() {
        let mut thinned = Thinned::new(4);
        let mut made = 0;
        for item in 0..23 {
            thinned.add(|| {
                made += 1;
                item
            });
        }
        assert_eq!(thinned.items(), [0, 8, 16]);
        assert_eq!(made, 9, "0 to 3, then 4 and 6, then 8 and 12, then 16");
    }
}

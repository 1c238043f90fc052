//! A value per pixel, for sensors that may not be known.

use evpr_core::plan::Sensor;

/// Most memory of a grid, bytes.
const MOST_BYTES: usize = 64 << 20;

/// A value per pixel. Where the sensor is not known, or too large to be held whole, it grows to the pixels asked for.
#[derive(Debug)]
pub(crate) struct Grid<T> {
    width: usize,
    height: usize,
    cells: Vec<T>,
    empty: T,
    sensor: Option<Sensor>,
}

impl<T: Copy> Grid<T> {
    const MOST_CELLS: usize = MOST_BYTES / size_of::<T>();

    pub(crate) fn new(sensor: Option<Sensor>, empty: T) -> Self {
        let whole = sensor.filter(|s| s.width.saturating_mul(s.height) <= Self::MOST_CELLS);
        let (width, height) = whole.map_or((0, 0), |s| (s.width, s.height));
        Self {
            width,
            height,
            cells: vec![empty; width * height],
            empty,
            sensor,
        }
    }

    /// The value of a pixel. `None` outside the sensor, and where the memory does not suffice.
    #[inline]
    pub(crate) fn at(&mut self, x: u16, y: u16) -> Option<&mut T> {
        let (x, y) = (usize::from(x), usize::from(y));
        if (x >= self.width || y >= self.height) && !self.grow(x, y) {
            return None;
        }
        self.cells.get_mut(y * self.width + x)
    }

    #[cold]
    fn grow(&mut self, x: usize, y: usize) -> bool {
        let (most_x, most_y) = self
            .sensor
            .map_or((usize::MAX, usize::MAX), |s| (s.width, s.height));
        if x >= most_x || y >= most_y {
            return false;
        }
        let width = self.width.max((x + 1).next_power_of_two().min(most_x));
        let height = self.height.max((y + 1).next_power_of_two().min(most_y));
        if width.saturating_mul(height) > Self::MOST_CELLS {
            return false;
        }
        let mut cells = vec![self.empty; width * height];
        if self.width > 0 {
            for (new, old) in cells
                .chunks_exact_mut(width)
                .zip(self.cells.chunks_exact(self.width))
            {
                new[..self.width].copy_from_slice(old);
            }
        }
        (self.width, self.height, self.cells) = (width, height, cells);
        true
    }

    /// Columns and rows held.
    pub(crate) fn size(&self) -> (usize, usize) {
        (self.width, self.height)
    }

    /// All values, by rows.
    pub(crate) fn cells(&self) -> &[T] {
        &self.cells
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_unknown_sensor_grows_and_keeps_what_was() {
        let mut grid = Grid::new(None, 0u32);
        for (i, (x, y)) in [(3u16, 1u16), (0, 0), (40, 2), (1, 300)].into_iter().enumerate() {
            *grid.at(x, y).unwrap() = i as u32 + 1;
        }
        assert_eq!(grid.size(), (64, 512));
        for (i, (x, y)) in [(3u16, 1u16), (0, 0), (40, 2), (1, 300)].into_iter().enumerate() {
            assert_eq!(*grid.at(x, y).unwrap(), i as u32 + 1);
        }
        assert_eq!(grid.cells().iter().filter(|n| **n > 0).count(), 4);
        assert!(grid.at(u16::MAX, u16::MAX).is_none());
        assert_eq!(grid.size(), (64, 512));
    }

    #[test]
    fn a_known_sensor_is_never_left() {
        let small = Sensor { height: 2, width: 3 };
        let mut grid = Grid::new(Some(small), 0u8);
        assert!(grid.at(2, 1).is_some() && grid.at(3, 0).is_none() && grid.at(0, 2).is_none());
        // Too large to be held whole.
        let large = Sensor {
            height: 20_000,
            width: 20_000,
        };
        let mut grid = Grid::new(Some(large), 0u64);
        assert_eq!(grid.size(), (0, 0));
        assert!(grid.at(100, 100).is_some() && grid.at(20_000, 0).is_none());
    }
}

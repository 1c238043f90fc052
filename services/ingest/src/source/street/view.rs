//! The camera: which part of the street each pixel sees, as long as the camera looks along the street and keeps to
//! its side of it.

use evpr_core::plan::Sensor;

/// Distance of the façades from the street's middle, metres.
pub(super) const WALL_M: f32 = 12.0;
/// Height of the camera above the road, metres.
pub(super) const CAMERA_HEIGHT_M: f32 = 1.4;
/// How far the street is drawn, metres from the camera.
pub(super) const FAR_M: f32 = 200.0;
/// Half of the angle that the sensor's width sees, as its tangent: 55° in all.
const HALF_WIDTH_TANGENT: f32 = 0.520_567;
/// Where the horizon is, as a part of the sensor's height from above.
const HORIZON: f32 = 0.58;

/// The left and the right side of the street, as indices.
pub(super) const LEFT: usize = 0;
pub(super) const RIGHT: usize = 1;

/// What a column of pixels sees of its façade. Depths are metres ahead of the camera.
#[derive(Debug, Clone, Copy)]
pub(super) struct Column {
    /// [`LEFT`] or [`RIGHT`].
    pub(super) side: usize,
    /// Depth at the column's middle, and at its edges.
    pub(super) depth_m: f32,
    pub(super) near_m: f32,
    pub(super) far_m: f32,
    /// Tangent of the angle to the left of straight ahead.
    pub(super) tangent: f32,
}

/// What a row of pixels sees of the ground.
#[derive(Debug, Clone, Copy)]
pub(super) struct GroundRow {
    pub(super) depth_m: f32,
    pub(super) near_m: f32,
    pub(super) far_m: f32,
}

#[derive(Debug, Clone)]
pub(super) struct View {
    pub(super) sensor: Sensor,
    /// Pixels per unit of tangent.
    pub(super) focal_px: f32,
    /// Row of the horizon, counted to the row's upper edge.
    pub(super) horizon: f32,
    /// The camera's distance to the left of the street's middle, metres.
    pub(super) lateral_m: f32,
    pub(super) columns: Vec<Column>,
    /// The rows that see ground, and the first of them.
    pub(super) ground: Vec<GroundRow>,
    pub(super) first_ground_row: usize,
}

impl View {
    pub(super) fn new(sensor: Sensor, lateral_m: f32) -> Self {
        let focal_px = 0.5 * sensor.width as f32 / HALF_WIDTH_TANGENT;
        let horizon = HORIZON * sensor.height as f32;
        let mut view = Self {
            sensor,
            focal_px,
            horizon,
            lateral_m,
            columns: Vec::new(),
            ground: Vec::new(),
            first_ground_row: horizon as usize,
        };
        view.columns = (0..sensor.width).map(|k| view.column(k)).collect();
        let depth = |rows_down: f32| {
            if rows_down > 0.0 {
                (focal_px * CAMERA_HEIGHT_M / rows_down).min(FAR_M)
            } else {
                FAR_M
            }
        };
        let row = |v: usize| {
            let down = v as f32 - horizon;
            let near_m = depth(down + 1.0);
            GroundRow {
                depth_m: depth(down + 0.5),
                near_m,
                far_m: depth(down).max(near_m + 0.01),
            }
        };
        view.ground = (view.first_ground_row..sensor.height).map(row).collect();
        view
    }

    /// Tangent to the left of straight ahead at a place along a row, pixels.
    pub(super) fn tangent(&self, column: f32) -> f32 {
        (0.5 * self.sensor.width as f32 - column) / self.focal_px
    }

    fn column(&self, k: usize) -> Column {
        let (left, middle, right) = (
            self.tangent(k as f32),
            self.tangent(k as f32 + 0.5),
            self.tangent(k as f32 + 1.0),
        );
        let side = if middle >= 0.0 { LEFT } else { RIGHT };
        let wall = if side == LEFT {
            WALL_M - self.lateral_m
        } else {
            WALL_M + self.lateral_m
        };
        // Straight ahead is infinitely far.
        let depth = |tangent: f32| (wall / tangent.abs()).min(FAR_M);
        let near_m = depth(left.abs().max(right.abs()));
        Column {
            side,
            depth_m: depth(middle),
            near_m: near_m.min(FAR_M - 1.0),
            far_m: if left * right < 0.0 {
                FAR_M
            } else {
                depth(left.abs().min(right.abs()))
            },
            tangent: middle,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_see_what_lies_in_their_direction() {
        for (height, width) in [(120, 160), (260, 346), (1, 1), (3, 7), (720, 1280)] {
            let view = View::new(Sensor { height, width }, -1.25);
            assert_eq!(view.columns.len(), width);
            assert_eq!(view.first_ground_row + view.ground.len(), height);
            for c in &view.columns {
                assert!(c.near_m < c.far_m && c.near_m > 5.0 && c.far_m <= FAR_M, "{c:?}");
                assert!(c.near_m <= c.depth_m && c.depth_m <= c.far_m, "{c:?}");
            }
            for r in &view.ground {
                assert!(r.near_m < r.far_m && r.near_m > 0.0, "{r:?}");
            }
        }
        let view = View::new(
            Sensor {
                height: 120,
                width: 160,
            },
            -1.0,
        );
        // At the left edge: 13 m to the side, 27.5° off: 25 m ahead.
        assert!(
            (view.columns[0].near_m - 24.97).abs() < 0.1,
            "{:?}",
            view.columns[0]
        );
        assert!((view.columns[159].near_m - 21.13).abs() < 0.1);
        assert_eq!((view.columns[0].side, view.columns[159].side), (LEFT, RIGHT));
    }
}

//! What the channels of frames are drawn in: brighter and darker in colours that the colour-blind can tell apart (Okabe
//! and Ito).

use evpr_core::message::ChannelOrder;

/// Brighter: orange.
pub(crate) const ON: [u8; 3] = [0xe6, 0x9f, 0x00];
/// Darker: sky blue.
pub(crate) const OFF: [u8; 3] = [0x56, 0xb4, 0xe9];

/// A pixel in red, green and blue, given its channels; missing ones are 0.
pub(crate) fn color(order: ChannelOrder, values: [u8; 3]) -> [u8; 3] {
    let [a, b, c] = values;
    match order {
        ChannelOrder::Grey => [a; 3],
        ChannelOrder::BlueGreenRed => [c, b, a],
        ChannelOrder::OffOnZero => mixed(b, a),
        ChannelOrder::OnOffZero => mixed(a, b),
    }
}

/// Both polarities, each in its colour.
fn mixed(on: u8, off: u8) -> [u8; 3] {
    let mix =
        |a: u8, z: u8| ((u32::from(a) * u32::from(on) + u32::from(z) * u32::from(off)) / 255).min(255) as u8;
    [mix(ON[0], OFF[0]), mix(ON[1], OFF[1]), mix(ON[2], OFF[2])]
}

/// The pixels of a frame with their channels, rows one after another; missing channels are 0.
pub(crate) fn pixels(order: ChannelOrder, frame: &[u8]) -> impl Iterator<Item = [u8; 3]> {
    let channels = order.channels().max(1);
    frame.chunks_exact(channels).map(|pixel| {
        let value = |i: usize| pixel.get(i).copied().unwrap_or(0);
        [value(0), value(1), value(2)]
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn polarities_keep_their_colours_whatever_the_order_of_channels() {
        let drawn =
            |order, frame: &[u8]| -> Vec<[u8; 3]> { pixels(order, frame).map(|p| color(order, p)).collect() };
        assert_eq!(drawn(ChannelOrder::OffOnZero, &[0, 255, 0, 255, 0, 0]), [ON, OFF]);
        assert_eq!(drawn(ChannelOrder::OnOffZero, &[255, 0, 0, 0, 255, 0]), [ON, OFF]);
        assert_eq!(drawn(ChannelOrder::Grey, &[7, 8]), [[7; 3], [8; 3]]);
        assert_eq!(drawn(ChannelOrder::BlueGreenRed, &[1, 2, 3]), [[3, 2, 1]]);
        // Both at once are light, and nothing is brighter than white.
        assert_eq!(drawn(ChannelOrder::OffOnZero, &[255, 255, 0])[0][1], 255);
    }
}

//! Scales pictures down until a scene fits its bounds.

use super::area::area;
use crate::limits::{MAX_IMAGE_SIDE_PX, MAX_IMAGES_PIXELS};

/// Returns how often the sides of each picture must be halved: until no side is beyond [`MAX_IMAGE_SIDE_PX`], and then
/// the largest of all, the first one of equals, until together they have at most [`MAX_IMAGES_PIXELS`].
///
/// So small pictures, where a halving saves little, stay whole.
pub(crate) fn halvings(sizes: &[(u32, u32)]) -> Vec<u32> {
    let halved = |(width, height): (u32, u32), times: u32| ((width >> times).max(1), (height >> times).max(1));
    let pixels = |size, times| {
        let (width, height) = halved(size, times);
        area(width, height)
    };
    let fits = |size: (u32, u32), times: &u32| {
        let (width, height) = halved(size, *times);
        width.max(height) <= MAX_IMAGE_SIDE_PX
    };
    let mut times: Vec<u32> =
        sizes.iter().map(|size| (0..32).find(|times| fits(*size, times)).unwrap_or_default()).collect();
    let mut total: u64 = sizes.iter().zip(&times).map(|(size, times)| pixels(*size, *times)).sum();
    // A picture is halved at most 14 times before it is a pixel, so this ends soon.
    while total > MAX_IMAGES_PIXELS {
        let all = sizes.iter().zip(&times).enumerate();
        let largest = all.rev().max_by_key(|(_, (size, times))| pixels(**size, **times));
        let Some((at, (size, _))) = largest else { break };
        let Some(times) = times.get_mut(at) else { break };
        total -= pixels(*size, *times);
        *times += 1;
        total += pixels(*size, *times);
    }
    times
}

/// Halves the sides of a picture so many times, rounded down. Each texel becomes the mean of those it covers, channel
/// by channel: what the channels hold is not known here.
pub(super) fn down(width: u32, height: u32, rgba: Vec<u8>, halvings: u32) -> (u32, u32, Vec<u8>) {
    if halvings == 0 {
        return (width, height, rgba);
    }
    let (to_width, to_height) = ((width >> halvings).max(1), (height >> halvings).max(1));
    let (from, row) = (rgba, width as usize * 4);
    let mut out = Vec::with_capacity(to_width as usize * to_height as usize * 4);
    let span = |at: u32, to: u32, from: u32| {
        let edge = |at: u32| usize::try_from(u64::from(at) * u64::from(from) / u64::from(to)).unwrap_or_default();
        edge(at)..edge(at + 1)
    };
    for y in 0..to_height {
        for x in 0..to_width {
            let (rows, columns) = (span(y, to_height, height), span(x, to_width, width));
            let mut sum = [0_u64; 4];
            for row in from.chunks_exact(row).take(rows.end).skip(rows.start) {
                for texel in row.get(columns.start * 4..columns.end * 4).unwrap_or_default().chunks_exact(4) {
                    for (sum, value) in sum.iter_mut().zip(texel) {
                        *sum += u64::from(*value);
                    }
                }
            }
            let count = (rows.len() * columns.len()).max(1) as u64;
            out.extend(sum.map(|sum| u8::try_from((sum + count / 2) / count).unwrap_or(255)));
        }
    }
    (to_width, to_height, out)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pictures_are_halved_largest_first_until_all_fit() {
        assert_eq!(halvings(&[(8192, 8192), (8192, 8192)]), [0, 0]);
        assert_eq!(halvings(&[(16384, 16), (8193, 8192), (16384, 8192)]), [1, 1, 1]);
        assert_eq!(halvings(&[(16, 16), (8192, 8192), (8192, 8192)]), [0, 1, 0]);
        let nine = halvings(&[(4096, 4096); 9]);
        assert_eq!(nine, [1, 1, 0, 0, 0, 0, 0, 0, 0]);
        // The bound holds however many there are.
        let many = vec![(16384, 8192); 4096];
        let times = halvings(&many);
        let total: u64 = times.iter().map(|times| area(16384 >> times, 8192 >> times)).sum();
        assert!(total <= MAX_IMAGES_PIXELS && times.iter().all(|times| *times == 6), "{total}");
    }

    #[test]
    fn texels_become_the_mean_of_those_they_cover() {
        let ramp = |width: u32, height: u32| -> Vec<u8> {
            let ten = |at: u32| u8::try_from(at * 10).unwrap();
            let texel = |at: u32| [ten(at % width), ten(at / width), 7, 255];
            (0..width * height).flat_map(texel).collect()
        };
        assert_eq!(down(4, 2, ramp(4, 2), 1), (2, 1, vec![5, 5, 7, 255, 25, 5, 7, 255]));
        // An odd side loses no texel: the last one covers three.
        assert_eq!(down(5, 1, ramp(5, 1), 1), (2, 1, vec![5, 0, 7, 255, 30, 0, 7, 255]));
        assert_eq!(down(3, 3, ramp(3, 3), 4), (1, 1, vec![10, 10, 7, 255]));
    }
}

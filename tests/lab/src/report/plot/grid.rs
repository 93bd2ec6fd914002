//! A grid of pictures with captions.

use anyhow::{Context, Result, ensure};
use image::{GenericImage as _, Rgb, RgbImage};
use noto_sans_mono_bitmap::{FontWeight, RasterHeight, get_raster, get_raster_width};

const LETTER_PX: u32 = 16;
const CAPTION_PX: u32 = LETTER_PX + 8;
const GAP_PX: u32 = 6;
const MAX_SIDE_PX: u32 = 32_768;

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Cell {
    /// One line, cut off at the picture's width.
    pub caption: String,
    pub picture: RgbImage,
}

/// Lays out rows of cells on white. Columns are as wide as their widest picture, rows as high as their highest. Errors
/// if there is no picture, or a side would exceed 32,768 pixels.
pub fn grid(rows: &[Vec<Cell>]) -> Result<RgbImage> {
    let columns = rows.iter().map(Vec::len).max().unwrap_or(0);
    let width_of = |column: usize| rows.iter().filter_map(|row| row.get(column)).map(|cell| cell.picture.width()).max();
    let height_of = |row: &Vec<Cell>| row.iter().map(|cell| cell.picture.height()).max();
    let widths: Vec<u32> = (0..columns).filter_map(width_of).collect();
    let heights: Vec<u32> = rows.iter().filter_map(height_of).collect();
    ensure!(!widths.is_empty() && heights.len() == rows.len(), "a grid needs pictures in every row");
    let side = |sizes: &[u32], extra: u32| {
        let sum = sizes.iter().map(|&size| u64::from(size) + u64::from(extra + GAP_PX)).sum::<u64>();
        u32::try_from(sum + u64::from(GAP_PX))
            .ok()
            .filter(|&side| side <= MAX_SIDE_PX)
            .with_context(|| format!("a grid of {columns} × {} pictures is too large", rows.len()))
    };
    let mut whole = RgbImage::from_pixel(side(&widths, 0)?, side(&heights, CAPTION_PX)?, Rgb([255; 3]));
    let mut y = GAP_PX;
    for (row, height) in rows.iter().zip(heights) {
        let mut x = GAP_PX;
        for (cell, &width) in row.iter().zip(&widths) {
            write(&mut whole, &cell.caption, (x, y + (CAPTION_PX - LETTER_PX) / 2), width);
            whole.copy_from(&cell.picture, x, y + CAPTION_PX)?;
            x += width + GAP_PX;
        }
        y += CAPTION_PX + height + GAP_PX;
    }
    Ok(whole)
}

/// Writes black text with its upper left corner at `(x, y)`, cut off at `width`.
fn write(whole: &mut RgbImage, text: &str, (x, y): (u32, u32), width: u32) {
    let letter_px = u32::try_from(get_raster_width(FontWeight::Regular, RasterHeight::Size16)).unwrap_or(LETTER_PX);
    for (letter, left) in text.chars().zip((x..).step_by(letter_px as usize)).take((width / letter_px) as usize) {
        let raster = |letter| get_raster(letter, FontWeight::Regular, RasterHeight::Size16);
        // The font has Latin letters only.
        let Some(raster) = raster(letter).or_else(|| raster('?')) else { continue };
        for (row, y) in raster.rows().zip(y..) {
            for (&ink, x) in row.iter().zip(left..) {
                if ink > 0 {
                    whole.put_pixel(x, y, Rgb([255 - ink; 3]));
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cell(caption: &str, width: u32, height: u32, value: u8) -> Cell {
        Cell { caption: caption.into(), picture: RgbImage::from_pixel(width, height, Rgb([value; 3])) }
    }

    #[test]
    fn every_picture_is_in_its_place_under_its_caption() {
        let rows =
            [vec![cell("lag 6, ×2", 100, 20, 10), cell("b", 50, 30, 20)], vec![cell("→ long caption", 40, 10, 30)]];
        let whole = grid(&rows).unwrap();
        assert_eq!(whole.dimensions(), (6 + 106 + 56, 6 + 24 + 30 + 6 + 24 + 10 + 6));
        let at = |x, y| whole.get_pixel(x, y)[0];
        assert_eq!((at(6, 30), at(105, 49), at(106, 40), at(105, 50)), (10, 10, 255, 255));
        assert_eq!((at(112, 30), at(161, 59), at(6, 90), at(45, 99)), (20, 20, 30, 30));
        let dark = |x: std::ops::Range<u32>, y: std::ops::Range<u32>| {
            x.flat_map(|x| y.clone().map(move |y| (x, y))).filter(|&(x, y)| at(x, y) < 128).count()
        };
        assert!(dark(6..106, 6..30) > 30 && dark(112..162, 6..30) > 5 && dark(6..112, 66..90) > 20);
        // A caption is no wider than its column.
        assert_eq!(dark(106..112, 0..96), 0);
        assert!(grid(&[]).is_err() && grid(&[vec![]]).is_err());
    }
}

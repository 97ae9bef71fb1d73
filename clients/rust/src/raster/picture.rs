//! A finished picture, and its PNG.

use thiserror::Error;

/// A finished picture: 8-bit red, green, blue; rows from the top.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Picture {
    /// Width in pixels.
    pub width_px: u32,
    /// Height in pixels.
    pub height_px: u32,
    /// Three bytes a pixel.
    pub rgb: Vec<u8>,
}

/// Why a picture could not be encoded.
#[derive(Debug, Error)]
#[error("encoding a picture of {width_px} x {height_px} pixels as PNG: {source}")]
pub struct EncodeError {
    /// Width in pixels.
    pub width_px: u32,
    /// Height in pixels.
    pub height_px: u32,
    /// The encoder's words.
    pub source: png::EncodingError,
}

impl Picture {
    /// A picture of one colour.
    pub fn blank(width_px: u32, height_px: u32, colour: [u8; 3]) -> Self {
        Self { width_px, height_px, rgb: colour.repeat(width_px as usize * height_px as usize) }
    }

    /// Writes one line of text in dots of `size_px`, 5 by 7 a character and one between, its upper left corner at
    /// (x, y).
    pub fn write(&mut self, text: &str, [x, y]: [u32; 2], size_px: u32, colour: [u8; 3]) {
        super::font::print_line(self, text, [x, y], size_px, colour);
    }

    /// Writes lines of text in the upper left corner on a dark panel.
    pub fn caption(&mut self, lines: &[String]) {
        super::font::print_panel(self, lines, &[]);
    }

    /// The picture as a PNG file, the same bytes every time.
    pub fn png(&self) -> Result<Vec<u8>, EncodeError> {
        let error = |source| EncodeError { width_px: self.width_px, height_px: self.height_px, source };
        let mut out = Vec::new();
        let mut encoder = png::Encoder::new(&mut out, self.width_px, self.height_px);
        encoder.set_color(png::ColorType::Rgb);
        encoder.set_depth(png::BitDepth::Eight);
        encoder.set_compression(png::Compression::Fast);
        let mut writer = encoder.write_header().map_err(error)?;
        writer.write_image_data(&self.rgb).map_err(error)?;
        writer.finish().map_err(error)?;
        Ok(out)
    }

    /// The colour of a pixel; `None` beyond the picture.
    pub fn pixel(&self, x: u32, y: u32) -> Option<[u8; 3]> {
        if x >= self.width_px || y >= self.height_px {
            return None;
        }
        let n = 3 * (y as usize * self.width_px as usize + x as usize);
        self.rgb.get(n..n + 3)?.try_into().ok()
    }

    /// Mixes a colour over a pixel, `opacity` of 255; nothing beyond the picture.
    pub fn blend(&mut self, x: u32, y: u32, colour: [u8; 3], opacity: u32) {
        if x >= self.width_px || y >= self.height_px {
            return;
        }
        let n = 3 * (y as usize * self.width_px as usize + x as usize);
        for (old, new) in self.rgb[n..n + 3].iter_mut().zip(colour) {
            *old = ((u32::from(*old) * (255 - opacity) + u32::from(new) * opacity) / 255) as u8;
        }
    }
}

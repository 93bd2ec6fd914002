//! Reads textures and their samplers, and collects the images that the scene uses.

use gltf::json::{
    self, Index,
    texture::{MagFilter, MinFilter, WrappingMode},
    validation::Checked,
};

use crate::{
    Filter, Texture, Wrap,
    error::place,
    reader::{
        json::{Document, source},
        report::LoadReport,
    },
};

/// Where an image of the scene comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum ImageSource {
    File(Index<json::Image>),
    /// Roughness made of the glossiness in another image's alpha, times a factor, whose bits are given.
    Roughness {
        image: u32,
        glossiness: u32,
    },
}

/// Images that the scene uses, in the order of their first use.
#[derive(Default)]
pub(crate) struct Images(pub(crate) Vec<ImageSource>);

impl Images {
    /// Returns the scene's index of an image. Images of one file or view are one.
    pub(crate) fn index(&mut self, document: &Document, image: ImageSource) -> u32 {
        let file = |index: Index<json::Image>| document.json.get(index);
        let same = |known: &ImageSource| match (*known, image) {
            (ImageSource::File(a), ImageSource::File(b)) if a != b => file(a).zip(file(b)).is_some_and(|(a, b)| {
                (a.uri.is_some() || a.buffer_view.is_some()) && a.buffer_view == b.buffer_view && a.uri == b.uri
            }),
            (a, b) => a == b,
        };
        let known = self.0.iter().position(same);
        let index = known.unwrap_or_else(|| {
            self.0.push(image);
            self.0.len() - 1
        });
        u32::try_from(index).unwrap_or(u32::MAX)
    }

    /// Returns a texture that lies where `Scene::uvs` say. `None`, with a warning, if it has no image.
    pub(crate) fn texture(
        &mut self,
        document: &Document,
        index: Index<json::Texture>,
        report: &mut LoadReport,
    ) -> Option<Texture> {
        let here = || place("texture", index.value(), None);
        let texture = document.json.get(index)?;
        let Some(image) = source(texture) else {
            report.left_out("a texture without an image", &here());
            return None;
        };
        let mut faults = 0;
        let sampler = texture.sampler.and_then(|sampler| document.json.get(sampler));
        let mut wrap = |mode: Option<Checked<WrappingMode>>| match mode.unwrap_or_default() {
            Checked::Valid(WrappingMode::Repeat) => Wrap::Repeat,
            Checked::Valid(WrappingMode::MirroredRepeat) => Wrap::MirroredRepeat,
            Checked::Valid(WrappingMode::ClampToEdge) => Wrap::ClampToEdge,
            Checked::Invalid => {
                faults += 1;
                Wrap::Repeat
            }
        };
        let wrap_u = wrap(sampler.map(|sampler| sampler.wrap_s));
        let wrap_v = wrap(sampler.map(|sampler| sampler.wrap_t));
        let magnified = match sampler.and_then(|sampler| sampler.mag_filter) {
            Some(Checked::Valid(MagFilter::Nearest)) => Filter::Nearest,
            Some(Checked::Valid(MagFilter::Linear)) | None => Filter::Linear,
            Some(Checked::Invalid) => {
                faults += 1;
                Filter::Linear
            }
        };
        let (minified, mips) = match sampler.and_then(|sampler| sampler.min_filter) {
            Some(Checked::Valid(filter)) => reduced(filter),
            None => reduced(MinFilter::LinearMipmapLinear),
            Some(Checked::Invalid) => {
                faults += 1;
                reduced(MinFilter::LinearMipmapLinear)
            }
        };
        if faults > 0 {
            report.mended("an unknown filter or wrap mode: linear, repeating", &here());
        }
        let image = self.index(document, ImageSource::File(image));
        Some(Texture { magnified, minified, mips, ..Texture::new(image, wrap_u, wrap_v) })
    }
}

fn reduced(filter: MinFilter) -> (Filter, Option<Filter>) {
    match filter {
        MinFilter::Nearest => (Filter::Nearest, None),
        MinFilter::Linear => (Filter::Linear, None),
        MinFilter::NearestMipmapNearest => (Filter::Nearest, Some(Filter::Nearest)),
        MinFilter::LinearMipmapNearest => (Filter::Linear, Some(Filter::Nearest)),
        MinFilter::NearestMipmapLinear => (Filter::Nearest, Some(Filter::Linear)),
        MinFilter::LinearMipmapLinear => (Filter::Linear, Some(Filter::Linear)),
    }
}

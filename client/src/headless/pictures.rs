//! Writes PNG files on threads behind a short queue. A slow disk slows the run but loses nothing.

use std::{
    fs::File,
    io::{BufWriter, Write as _},
    path::{Path, PathBuf},
    sync::{
        Arc,
        mpsc::{Receiver, SyncSender, sync_channel},
    },
    thread::JoinHandle,
};

use image::{
    ExtendedColorType, ImageEncoder as _,
    codecs::png::{CompressionType, FilterType, PngEncoder},
};
use parking_lot::Mutex;

use crate::{error::ClientError, render::readback::Picture};

const QUEUE_PICTURES: usize = 4;

const MAX_WRITERS: usize = 4;

#[derive(Debug)]
pub struct PictureWriter {
    queue: Option<SyncSender<Picture>>,
    threads: Vec<JoinHandle<()>>,
    failure: Arc<Mutex<Option<(PathBuf, std::io::Error)>>>,
}

impl PictureWriter {
    /// Creates the folder and starts the threads.
    ///
    /// # Errors
    /// Errors if the folder cannot be created.
    pub fn start(folder: &Path) -> Result<Self, ClientError> {
        let failed = |source| ClientError::Write { path: folder.into(), source };
        std::fs::create_dir_all(folder).map_err(failed)?;
        let (queue, pictures) = sync_channel::<Picture>(QUEUE_PICTURES);
        let pictures = Arc::new(Mutex::new(pictures));
        let failure = Arc::new(Mutex::new(None));
        let writers = std::thread::available_parallelism().map_or(1, usize::from).min(MAX_WRITERS);
        let threads = (0..writers)
            .map(|_| {
                let (folder, pictures, failure) = (folder.to_owned(), Arc::clone(&pictures), Arc::clone(&failure));
                std::thread::Builder::new()
                    .name("png".to_owned())
                    .spawn(move || write_all(&folder, &pictures, &failure))
            })
            .collect::<Result<_, _>>()
            .map_err(failed)?;
        Ok(Self { queue: Some(queue), threads, failure })
    }

    /// Queues a picture. Waits while the queue is full.
    ///
    /// # Errors
    /// Errors if an earlier picture could not be written.
    pub fn write(&self, picture: Picture) -> Result<(), ClientError> {
        self.check()?;
        if let Some(queue) = &self.queue
            && queue.send(picture).is_err()
        {
            // A thread stops only if writing failed.
            self.check()?;
        }
        Ok(())
    }

    /// Waits until all pictures are written.
    ///
    /// # Errors
    /// Errors if one could not be written.
    pub fn finish(mut self) -> Result<(), ClientError> {
        self.queue = None;
        for thread in self.threads.drain(..) {
            if let Err(panic) = thread.join() {
                std::panic::resume_unwind(panic);
            }
        }
        self.check()
    }

    fn check(&self) -> Result<(), ClientError> {
        let failed = self.failure.lock().take();
        failed.map_or(Ok(()), |(path, source)| Err(ClientError::Write { path, source }))
    }
}

fn write_all(folder: &Path, pictures: &Mutex<Receiver<Picture>>, failure: &Mutex<Option<(PathBuf, std::io::Error)>>) {
    loop {
        let next = pictures.lock().recv();
        let Ok(picture) = next else { return };
        let path = folder.join(format!("frame_{:06}.png", picture.frame));
        if let Err(source) = write(&path, &picture) {
            // A truncated picture is worse than none.
            let _ = std::fs::remove_file(&path);
            failure.lock().get_or_insert((path, source));
            return;
        }
    }
}

pub(crate) fn write(path: &Path, picture: &Picture) -> std::io::Result<()> {
    let mut file = BufWriter::new(File::create(path)?);
    // Alpha is always 255, and would cost a third more space and time.
    let rgb: Vec<u8> = picture.rgba.chunks_exact(4).flat_map(|texel| [texel[0], texel[1], texel[2]]).collect();
    PngEncoder::new_with_quality(&mut file, CompressionType::Fast, FilterType::Adaptive)
        .write_image(&rgb, picture.width, picture.height, ExtendedColorType::Rgb8)
        .map_err(|error| match error {
            image::ImageError::IoError(source) => source,
            error => std::io::Error::other(error),
        })?;
    // Dropping the buffer would hide the error of a full disk.
    file.flush()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn picture(frame: u64) -> Picture {
        let rgba = (0..6_u8).flat_map(|i| [i * 40, u8::try_from(frame).unwrap(), 7, 255]).collect();
        Picture { frame, width: 3, height: 2, rgba }
    }

    #[test]
    fn every_picture_is_written_unchanged() {
        let folder = tempfile::tempdir().unwrap();
        let writer = PictureWriter::start(&folder.path().join("new/folder")).unwrap();
        for frame in 0..20 {
            writer.write(picture(frame)).unwrap();
        }
        writer.finish().unwrap();
        for frame in 0..20 {
            let file = folder.path().join(format!("new/folder/frame_{frame:06}.png"));
            assert_eq!(image::open(&file).unwrap().to_rgba8().into_raw(), picture(frame).rgba);
        }
    }

    #[test]
    fn a_folder_that_cannot_be_written_is_an_error() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("file");
        std::fs::write(&file, b"").unwrap();
        assert!(matches!(PictureWriter::start(&file), Err(ClientError::Write { .. })));
        // The folder vanishes during the run.
        let gone = folder.path().join("gone");
        let writer = PictureWriter::start(&gone).unwrap();
        std::fs::remove_dir(&gone).unwrap();
        let failed = (0..200).find_map(|frame| writer.write(picture(frame)).err());
        let error = failed.or_else(|| writer.finish().err()).unwrap();
        assert!(matches!(error, ClientError::Write { .. }), "{error}");
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn a_full_disk_is_an_error_that_says_so() {
        // Writing to /dev/full always fails with a full disk.
        let error = write(Path::new("/dev/full"), &picture(0)).unwrap_err();
        assert_eq!(error.kind(), std::io::ErrorKind::StorageFull);
    }
}

//! Keeps a device's first failure until it is read.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// The first failure of a device: its loss, or an error that wgpu would otherwise panic about.
#[derive(Debug, Clone, Default)]
pub struct DeviceFailure(Arc<Mutex<Option<String>>>);

impl DeviceFailure {
    /// Watches a device. A later watch on the same device replaces this one.
    #[must_use]
    pub fn watch(device: &wgpu::Device) -> Self {
        let failure = Self::default();
        let (on_error, on_loss) = (failure.clone(), failure.clone());
        device.on_uncaptured_error(Arc::new(move |error| on_error.note(error.to_string())));
        device.set_device_lost_callback(move |reason, text| {
            // Dropping the device is reported too.
            if reason != wgpu::DeviceLostReason::Destroyed {
                on_loss.note(format!("the device is lost: {text}"));
            }
        });
        failure
    }

    #[must_use]
    pub fn get(&self) -> Option<String> {
        self.lock().clone()
    }

    /// Returns the failure and forgets it.
    #[must_use]
    pub fn take(&self) -> Option<String> {
        self.lock().take()
    }

    fn note(&self, reason: String) {
        self.lock().get_or_insert(reason);
    }

    fn lock(&self) -> MutexGuard<'_, Option<String>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

//! One admitted client, from Welcome to its end: control messages, poses in and frames out.

pub(crate) mod brightness;
mod budget;
mod control;
mod driver;
mod end;
mod feedback;
mod frame_encoder;
mod outbox;
mod poses;
pub(crate) mod run;
mod stream;
mod watchdog;

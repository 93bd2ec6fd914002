//! From datagrams to masks.

mod deadline;
mod frame_decoder;
mod frame_receiver;
pub mod reassembler;
mod requests;

pub use self::{
    frame_decoder::{BadFrame, BadFrameReason},
    frame_receiver::{Arrival, FrameReceiver, ReceivedFrame, ReceiverConfig, ReceiverCounters},
    requests::Requests,
};

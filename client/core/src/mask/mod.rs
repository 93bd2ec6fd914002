//! Received masks on their way to the renderer: [`queue`] passes them on, and [`matcher`] finds the request that each
//! one answers in the [`pose_history`]. [`world`] knows what people had changed in the scene that each was traced with.

pub mod digest;
pub mod matcher;
pub mod pose_history;
pub mod queue;
pub mod received;
pub mod world;

//! Received masks on their way to the renderer: [`queue`] hands them over, [`matcher`] finds the request that each one answers.

pub mod matcher;
pub mod queue;
pub mod received;

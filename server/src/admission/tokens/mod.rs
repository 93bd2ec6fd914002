//! Bearer tokens that admit a client.

pub(crate) mod store;

pub use self::store::{Scope, TokenError, make};

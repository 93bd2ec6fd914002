//! Why peers were refused, and how sessions ended.

/// Defines an enum with a metric label for each variant.
macro_rules! causes {
    ($(#[$meta:meta])* $name:ident { $($(#[$doc:meta])* $variant:ident = $label:literal,)* }) => {
        $(#[$meta])*
        #[derive(Debug, Clone, Copy, PartialEq, Eq)]
        pub(crate) enum $name {
            $($(#[$doc])* $variant,)*
        }

        impl $name {
            /// Metric labels, in order.
            pub(crate) const LABELS: &[&str] = &[$($label),*];
        }
    };
}

causes! {
    /// Why a peer got no session.
    RefusalCause {
        Token = "token",
        /// No permit was free.
        Full = "full",
        /// Devices, cores or network lack capacity.
        Budget = "budget",
        /// Its address is at its session limit.
        Address = "address",
        Draining = "draining",
        /// Another protocol version, or an impossible request.
        Unsupported = "unsupported",
        /// A page of an origin that is not listed.
        Origin = "origin",
        /// It broke off, or broke the protocol.
        Broken = "broken",
        /// No Hello in time.
        Silent = "silent",
        /// Too many handshakes under way: another took its place.
        Handshakes = "handshakes",
        /// An operator has ended its session.
        Dismissed = "dismissed",
        /// Too many connections without a session, or too many of its address.
        Connections = "connections",
        /// Its address opens connections too fast.
        Rate = "rate",
    }
}

causes! {
    /// How a session ended.
    EndCause {
        Left = "left",
        /// The connection was lost, or the client silent.
        Lost = "lost",
        Violation = "violation",
        Failed = "failed",
        Stopping = "stopping",
        /// The operator ended it.
        Operator = "operator",
        /// Its token was withdrawn, or expired.
        Token = "token",
    }
}

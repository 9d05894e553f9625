//! Errors of the readers.

/// Fault of a file that should contain a camera.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ReadError {
    /// A value that must be there is not.
    #[error("{format}: {field} is missing")]
    Missing {
        /// The format read.
        format: &'static str,
        /// Its name for the value.
        field: String,
    },
    /// A value that is not a number, not finite, or not allowed.
    #[error("{format}: {field} is {value:?}, expected {expected}")]
    BadValue {
        /// The format read.
        format: &'static str,
        /// Its name for the value.
        field: String,
        /// The value in the file, shortened.
        value: String,
        /// The expected value.
        expected: &'static str,
    },
    /// Text that is not of the format at all.
    #[error("{format}: {reason}")]
    Malformed {
        /// The format read.
        format: &'static str,
        /// The fault.
        reason: String,
    },
    /// Text that is no known format.
    #[error(
        "{file}: no camera recognised in {found}; known are RPB, _RPC.TXT, DIMAP RPC_*.XML, Maxar XML, Sat-NeRF and \
         VisSat JSON, ALOS RPC text and OSSIM .geom"
    )]
    Unrecognised {
        /// The name given to the text.
        file: String,
        /// The kind of file, as far as it is recognised.
        found: String,
    },
}

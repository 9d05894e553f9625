//! Errors of the readers.

/// Fault of a file that should contain a camera.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ReadError {
    /// A required value that is missing.
    #[error("{format}: {field} is missing")]
    Missing {
        /// Format of the file.
        format: &'static str,
        /// Name of the value in that format.
        field: String,
    },
    /// A value that is not a number, not finite, or not allowed.
    #[error("{format}: {field} is {value:?}, expected {expected}")]
    BadValue {
        /// Format of the file.
        format: &'static str,
        /// Name of the value in that format.
        field: String,
        /// The value in the file, shortened.
        value: String,
        /// The expected value.
        expected: &'static str,
    },
    /// Text that is not of the expected format.
    #[error("{format}: {reason}")]
    Malformed {
        /// Format of the file.
        format: &'static str,
        /// The fault.
        reason: String,
    },
    /// Text of no known format.
    #[error(
        "{file}: no camera recognised in {found}; known are RPB, _RPC.TXT, DIMAP RPC_*.XML, Maxar XML, Sat-NeRF and \
         VisSat JSON, ALOS RPC text and OSSIM .geom"
    )]
    Unrecognised {
        /// Name of the file.
        file: String,
        /// Kind of the text, as far as it is recognised.
        found: String,
    },
}

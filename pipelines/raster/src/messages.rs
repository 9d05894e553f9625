//! Messages of GDAL: kept per thread for our error messages, sent to the log, never printed by GDAL itself.

use gdal::config::set_error_handler;
use gdal::errors::CplErrType;
use std::cell::RefCell;
use std::path::Path;
use std::sync::Once;

thread_local! {
    static FAILURES: RefCell<Vec<String>> = const { RefCell::new(Vec::new()) };
}

static INSTALL: Once = Once::new();

/// Routes GDAL's messages to the log and to [`collect`], and restricts GDAL to the formats that this program reads.
/// Further calls have no effect.
pub fn install() {
    INSTALL.call_once(|| {
        set_error_handler(|class, _, message| match class {
            CplErrType::Failure | CplErrType::Fatal => {
                tracing::debug!("GDAL: {message}");
                FAILURES.with_borrow_mut(|failures| failures.push(one_line(message)));
            }
            CplErrType::Warning => tracing::debug!("GDAL warns: {message}"),
            _ => tracing::trace!("GDAL: {message}"),
        });
        crate::drivers::restrict();
    });
}

/// Seconds that a server may take to answer and to deliver, number of repetitions of a request that it refuses for a
/// moment, and seconds before the first of them, unless the environment sets them.
const PATIENCE: [(&str, &str); 4] = [
    ("GDAL_HTTP_CONNECTTIMEOUT", "20"),
    ("GDAL_HTTP_TIMEOUT", "300"),
    ("GDAL_HTTP_MAX_RETRY", "5"),
    ("GDAL_HTTP_RETRY_DELAY", "0.5"),
];

/// Option and file of the certificates of Debian and its kin; a libcurl that was built elsewhere does not find them.
const CERTIFICATES: (&str, &str) = ("SSL_CERT_FILE", "/etc/ssl/certs/ca-certificates.crt");

/// Enables GDAL's remote file systems for this process, because the user named a path on one.
pub fn allow_network() {
    install();
    let mut done = gdal::config::clear_config_option("CPL_VSIL_CURL_ALLOWED_FILENAME");
    let certificates = Some(&CERTIFICATES).filter(|(_, file)| Path::new(file).exists());
    let options = PATIENCE.iter().chain(certificates);
    for (key, value) in options.filter(|(key, _)| std::env::var_os(key).is_none()) {
        done = done.and(gdal::config::set_config_option(key, value));
    }
    if done.is_err() {
        tracing::debug!("GDAL takes no options");
    }
}

/// Runs `action`; an error carries GDAL's first failure message, which is closest to the cause.
///
/// # Errors
/// The message, on one line.
pub fn collect<T>(action: impl FnOnce() -> gdal::errors::Result<T>) -> Result<T, String> {
    install();
    FAILURES.with_borrow_mut(Vec::clear);
    let result = action();
    let first = FAILURES.with_borrow_mut(|failures| failures.drain(..).next());
    result.map_err(|error| first.unwrap_or_else(|| one_line(&error.to_string())))
}

/// Runs `action` as [`collect`] does; a failure that GDAL reports without returning an error is an error too.
///
/// # Errors
/// The message, on one line.
pub fn collect_strictly<T>(action: impl FnOnce() -> gdal::errors::Result<T>) -> Result<T, String> {
    install();
    FAILURES.with_borrow_mut(Vec::clear);
    let result = action();
    match (FAILURES.with_borrow_mut(|failures| failures.drain(..).next()), result) {
        (Some(message), _) => Err(message),
        (None, result) => result.map_err(|error| one_line(&error.to_string())),
    }
}

fn one_line(message: &str) -> String {
    message.split_whitespace().collect::<Vec<_>>().join(" ")
}

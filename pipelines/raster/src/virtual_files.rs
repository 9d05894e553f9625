//! Files on GDAL's virtual file systems, such as archives and object stores.

use super::write::write_atomically_with;
use super::{RasterError, Result, is_remote, messages};
use std::ffi::{CStr, CString};
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Paths in a folder of a virtual file system, sorted. A remote folder enables GDAL's remote file systems from then on.
///
/// # Errors
/// [`RasterError::Missing`] when there is no such folder, or it cannot be reached.
pub fn list_virtual(folder: &Path) -> Result<Vec<PathBuf>> {
    if is_remote(folder) {
        messages::allow_network();
    }
    let names = patiently(folder, || messages::collect(|| gdal::vsi::read_dir(folder, false)));
    let mut names = names.map_err(|_| RasterError::Missing(folder.to_owned()))?;
    names.sort();
    Ok(names.into_iter().map(|name| folder.join(name)).collect())
}

/// Most attempts of what a store refuses, and seconds before the second; the pause doubles each time.
const ATTEMPTS: u32 = 5;
const PAUSE_S: f64 = 0.2;

/// Result of `action`, which is repeated on a remote path: GDAL repeats refused reads, but no listing and no write.
fn patiently<T, E>(path: &Path, mut action: impl FnMut() -> Result<T, E>) -> Result<T, E> {
    let attempts = if is_remote(path) { ATTEMPTS } else { 1 };
    for attempt in 1..attempts {
        if let Ok(done) = action() {
            return Ok(done);
        }
        std::thread::sleep(Duration::from_secs_f64(PAUSE_S * f64::from(1 << (attempt - 1))));
        forget(path);
    }
    action()
}

/// Drops GDAL's memory of a remote path: a refused listing is kept as an empty one.
#[allow(unsafe_code, reason = "the crate gdal has no files on virtual file systems")]
fn forget(path: &Path) {
    if let Ok(name) = CString::new(path.to_string_lossy().as_bytes()) {
        // SAFETY: the text ends in a zero and outlives the call.
        unsafe { gdal_sys::VSICurlPartialClearCache(name.as_ptr()) };
    }
}

/// Bytes of one read or write.
const PART: usize = 8 << 20;

/// Copies a file, byte for byte, to a path on one of GDAL's virtual file systems.
///
/// # Errors
/// [`RasterError::Write`] with GDAL's message, and the operating system's errors of the source as
/// `RasterError::from_io` converts them.
pub fn deliver(source: &Path, target: &Path) -> Result<()> {
    messages::allow_network();
    patiently(target, || put(source, target))
}

fn put(source: &Path, target: &Path) -> Result<()> {
    let mut file = std::fs::File::open(source).map_err(|error| RasterError::from_io(source, &error))?;
    let failed = |reason: String| RasterError::Write(target.to_owned(), reason);
    let mut fault = None;
    messages::collect_strictly(|| {
        let mut out = VirtualFile::open(target, c"wb")?;
        let mut part = vec![0; PART];
        loop {
            match std::io::Read::read(&mut file, &mut part) {
                Ok(0) => return out.close(),
                Ok(bytes) => out.write(&part[..bytes])?,
                Err(error) => {
                    fault = Some(error);
                    return Ok(());
                }
            }
        }
    })
    .map_err(failed)?;
    fault.map_or(Ok(()), |error| Err(RasterError::from_io(source, &error)))
}

/// Copies a file, byte for byte, from a path on one of GDAL's virtual file systems; the copy is complete or absent.
///
/// # Errors
/// [`RasterError::Missing`] when there is no such file, and the errors of writing, also when the file ends early.
pub fn fetch(source: &Path, target: &Path) -> Result<()> {
    let (mut file, bytes) = open(source).ok_or_else(|| RasterError::Missing(source.to_owned()))?;
    let mut left = bytes;
    write_atomically_with(target, |out| {
        let mut part = vec![0; PART];
        while left > 0 {
            let read = file.read(&mut part);
            if read == 0 {
                return Err(std::io::Error::other(format!("{} ends early", source.display())));
            }
            out.write_all(&part[..read])?;
            left = left.saturating_sub(read as u64);
        }
        Ok(())
    })
}

/// At most the first `count` bytes of a file on one of GDAL's virtual file systems, and its size; `None` where there is
/// no such file.
pub fn read_virtual(path: &Path, count: u64) -> Option<(Vec<u8>, u64)> {
    let (mut file, bytes) = open(path)?;
    let mut start = vec![0; bytes.min(count) as usize];
    (file.read(&mut start) == start.len()).then_some((start, bytes))
}

/// Opens a file for reading, and returns its size, bytes.
fn open(path: &Path) -> Option<(VirtualFile, u64)> {
    if is_remote(path) {
        messages::allow_network();
    }
    let opened = messages::collect(|| {
        let mut file = VirtualFile::open(path, c"rb")?;
        let bytes = file.size()?;
        Ok((file, bytes))
    });
    opened.ok()
}

/// A file on one of GDAL's virtual file systems, read or written sequentially, as object stores require.
struct VirtualFile {
    handle: *mut gdal_sys::VSILFILE,
}

#[allow(unsafe_code, reason = "the crate gdal has no files on virtual file systems")]
impl VirtualFile {
    fn fault(what: &'static str) -> gdal::errors::GdalError {
        let (method_name, msg) = (what, "the store does not take it".into());
        gdal::errors::GdalError::NullPointer { method_name, msg }
    }

    fn open(path: &Path, mode: &CStr) -> gdal::errors::Result<Self> {
        let name = CString::new(path.to_string_lossy().as_bytes())?;
        // SAFETY: both texts end in a zero and outlive the call.
        let handle = unsafe { gdal_sys::VSIFOpenL(name.as_ptr(), mode.as_ptr()) };
        match handle.is_null() {
            true => Err(Self::fault("VSIFOpenL")),
            false => Ok(Self { handle }),
        }
    }

    fn write(&mut self, bytes: &[u8]) -> gdal::errors::Result<()> {
        // SAFETY: the handle is open, and the pointer leads to that many bytes.
        let written = unsafe { gdal_sys::VSIFWriteL(bytes.as_ptr().cast(), 1, bytes.len(), self.handle) };
        match written == bytes.len() {
            true => Ok(()),
            false => Err(Self::fault("VSIFWriteL")),
        }
    }

    /// Size, bytes; reading then begins at the start.
    fn size(&mut self) -> gdal::errors::Result<u64> {
        const FROM_START: i32 = 0;
        const FROM_END: i32 = 2;
        // SAFETY: the handle is open.
        let (end, bytes, start) = unsafe {
            let end = gdal_sys::VSIFSeekL(self.handle, 0, FROM_END);
            let bytes = gdal_sys::VSIFTellL(self.handle);
            (end, bytes, gdal_sys::VSIFSeekL(self.handle, 0, FROM_START))
        };
        match (end, start) {
            (0, 0) => Ok(bytes),
            _ => Err(Self::fault("VSIFSeekL")),
        }
    }

    /// Fills `bytes` from the current place on; returns the number of bytes read, less than asked at the end.
    fn read(&mut self, bytes: &mut [u8]) -> usize {
        // SAFETY: the handle is open, and the pointer leads to that many bytes.
        unsafe { gdal_sys::VSIFReadL(bytes.as_mut_ptr().cast(), 1, bytes.len(), self.handle) }
    }

    fn close(self) -> gdal::errors::Result<()> {
        let handle = self.handle;
        std::mem::forget(self);
        // SAFETY: the handle is open, and forgotten so that it is closed once.
        match unsafe { gdal_sys::VSIFCloseL(handle) } {
            0 => Ok(()),
            _ => Err(Self::fault("VSIFCloseL")),
        }
    }
}

#[allow(unsafe_code, reason = "the crate gdal has no files on virtual file systems")]
impl Drop for VirtualFile {
    fn drop(&mut self) {
        // SAFETY: the handle is open, because `close` forgets a file that it closed.
        unsafe { gdal_sys::VSIFCloseL(self.handle) };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_comes_back_from_a_virtual_file_system_as_it_was() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let [source, copy] = ["a.bin", "b.bin"].map(|name| folder.path().join(name));
        // More than one part.
        let bytes: Vec<u8> = (0..PART + 1000).map(|k| (k % 251) as u8).collect();
        std::fs::write(&source, &bytes).expect("written");
        let stored = Path::new("/vsimem/virtual_files_test/a.bin");
        deliver(&source, stored).expect("delivered");
        fetch(stored, &copy).expect("fetched");
        assert!(std::fs::read(&copy).expect("readable") == bytes);
        let (start, size) = read_virtual(stored, 100).expect("there");
        assert!(start == bytes[..100] && size == bytes.len() as u64);
        let absent = Path::new("/vsimem/virtual_files_test/none.bin");
        assert!(read_virtual(absent, 100).is_none());
        assert!(matches!(fetch(absent, &copy), Err(RasterError::Missing(_))));
        assert_eq!(
            list_virtual(Path::new("/vsimem/virtual_files_test")).expect("listed"),
            [stored]
        );
    }
}

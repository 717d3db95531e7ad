//! The actuator as an FMU (FMI 2.0, co-simulation): a zip of a description, a shared library and the parameters.
//!
//! The library, of the crate `ema-fmu`, is no part of this program: it is asked for everything else that the FMU
//! holds, so that description and library are of one build.

use schemas::error::{Error, Result};
use sim_worker::parameters::ActuatorParameters;
use std::ffi::{c_int, c_void};
use std::io::{Cursor, Write};
use std::path::{Path, PathBuf};
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, DateTime, ZipWriter};

/// How the library is built.
const BUILD: &str = "cargo build --release -p ema-fmu";

/// Folder of FMI for libraries of this platform; none where FMI 2.0 has no name for it.
fn platform() -> Option<&'static str> {
    match (std::env::consts::OS, std::env::consts::ARCH) {
        ("linux", "x86_64") => Some("linux64"),
        ("windows", "x86_64") => Some("win64"),
        ("macos", "x86_64") => Some("darwin64"),
        _ => None,
    }
}

/// Path and bytes of the files of an FMU.
type Files = Vec<(String, Vec<u8>)>;

unsafe extern "C" fn take(to: *mut c_void, name: *const u8, name_len: usize, bytes: *const u8, len: usize) {
    // SAFETY: `to` is what `files` hands over, the rest lives until the call is over
    let (to, name, bytes) = unsafe {
        (
            &mut *to.cast::<Files>(),
            std::slice::from_raw_parts(name, name_len),
            std::slice::from_raw_parts(bytes, len),
        )
    };
    to.push((String::from_utf8_lossy(name).into_owned(), bytes.to_vec()));
}

/// What the library says that an FMU of the actuator holds; first, without a name, the name of the library in it.
fn files(library: &Path, actuator: &ActuatorParameters) -> Result<Files> {
    type Ask = unsafe extern "C" fn(
        *const u8,
        usize,
        unsafe extern "C" fn(*mut c_void, *const u8, usize, *const u8, usize),
        *mut c_void,
    ) -> c_int;
    let place = format!("library `{}`", library.display());
    let bad = |found: String| Error::bad("ema export fmu", &place, found, format!("that of {BUILD}"));
    let toml = actuator.to_toml();
    let mut all = Files::new();
    // SAFETY: whoever names a library lets it run; ours does nothing when it is loaded, and the function of this name
    // has had this signature since there is one
    let status = unsafe {
        let library = libloading::Library::new(library).map_err(|e| bad(e.to_string()))?;
        let ask = library.get::<Ask>(b"ema_fmu_files\0").map_err(|e| bad(e.to_string()))?;
        ask(toml.as_ptr(), toml.len(), take, std::ptr::from_mut(&mut all).cast())
    };
    match (status, all.first()) {
        (0, Some((name, id))) if name.is_empty() && !id.is_empty() => Ok(all),
        (_, Some((_, why))) => Err(bad(String::from_utf8_lossy(why).into_owned())),
        (_, None) => Err(bad("no files".into())),
    }
}

/// The library beside `here`, that of the same build.
///
/// # Errors
/// Where there is none: how it is built.
pub fn find(here: Option<&Path>) -> Result<PathBuf> {
    let name = libloading::library_filename("ema_fmu");
    let beside = here.and_then(Path::parent).map(|dir| dir.join(&name));
    beside.filter(|p| p.is_file()).ok_or_else(|| {
        let place = format!("library `{}`", Path::new(&name).display());
        let allowed = format!("it beside ema, or --library PATH ({BUILD})");
        Error::bad("ema export fmu", place, "nothing", allowed)
    })
}

/// An FMU in bytes: the same for the same actuator and library.
///
/// # Errors
/// A library that is none or of another program; a platform that FMI 2.0 does not name.
pub fn fmu(actuator: &ActuatorParameters, library: &Path) -> Result<Vec<u8>> {
    let platform = platform().ok_or_else(|| {
        let found = format!("{} on {}", std::env::consts::OS, std::env::consts::ARCH);
        Error::bad(
            "ema export fmu",
            "platform",
            found,
            "linux, windows, macos on x86_64: those of FMI 2.0",
        )
    })?;
    // a bare name would be looked for in the system's folders
    let library = &std::fs::canonicalize(library).map_err(|e| Error::io(library, "cannot be read", e))?;
    let mut all = files(library, actuator)?;
    let (_, id) = all.remove(0);
    let id = String::from_utf8_lossy(&id).into_owned();
    let bytes = std::fs::read(library).map_err(|e| Error::io(library, "cannot be read", e))?;
    let path = format!("binaries/{platform}/{id}{}", std::env::consts::DLL_SUFFIX);
    all.push((path, bytes));
    let written = || -> zip::result::ZipResult<Vec<u8>> {
        let mut zip = ZipWriter::new(Cursor::new(Vec::new()));
        for (path, bytes) in &all {
            let permissions = if path.starts_with("binaries/") { 0o755 } else { 0o644 };
            let options = SimpleFileOptions::default()
                .compression_method(CompressionMethod::Deflated)
                .last_modified_time(DateTime::default())
                .unix_permissions(permissions);
            zip.start_file(path.as_str(), options)?;
            zip.write_all(bytes)?;
        }
        Ok(zip.finish()?.into_inner())
    };
    written().map_err(|e| Error::bad("ema export fmu", "archive", e, "files that fit into a zip"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn refuse_no_library_and_what_is_none() {
        let dir = tempfile::tempdir().unwrap();
        let ema = dir.path().join("ema");
        for here in [None, Some(ema.as_path())] {
            let e = find(here).unwrap_err().to_string();
            assert!(e.contains("ema_fmu") && e.contains(BUILD), "{e}");
        }
        let library = dir.path().join(libloading::library_filename("ema_fmu"));
        std::fs::write(&library, "no library").unwrap();
        assert_eq!(find(Some(&ema)).unwrap(), library);
        let e = fmu(&ActuatorParameters::reference(), &library).unwrap_err();
        assert!(e.to_string().contains(BUILD) && e.exit_code() == 4, "{e}");
    }
}

//! Decoders of other hands, kept from taking the program down.

use bytes::Bytes;
use parquet::file::reader::{ChunkReader, Length};
use std::cell::Cell;
use std::io::Read;
use std::sync::Once;

thread_local! {
    static GUARDED: Cell<bool> = const { Cell::new(false) };
}

/// Reads bytes that may be damaged: the Parquet library panics on some of them. Such a panic is an error, and
/// says nothing on standard error.
///
/// # Errors
/// A panic of `read`.
pub fn guarded<T>(read: impl FnOnce() -> T) -> std::result::Result<T, &'static str> {
    static HOOK: Once = Once::new();
    HOOK.call_once(|| {
        let before = std::panic::take_hook();
        std::panic::set_hook(Box::new(move |info| {
            if !GUARDED.get() {
                before(info);
            }
        }));
    });
    // one guarded reading may be part of another
    let before = GUARDED.replace(true);
    let done = std::panic::catch_unwind(std::panic::AssertUnwindSafe(read));
    GUARDED.set(before);
    done.map_err(|_| "damaged within")
}

/// What a panic said; nothing where it was no text.
pub fn words(panic: &(dyn std::any::Any + Send)) -> &str {
    let text = panic.downcast_ref::<String>().map(String::as_str);
    text.or(panic.downcast_ref::<&str>().copied()).unwrap_or_default()
}

/// A source of Parquet bytes whose end is an error for whoever asks for more: the library passes over what a page's header declares
/// even where the file has ended, two thousand million times at worst.
pub struct Ending<R>(pub R);

/// [`Ending`] as it is read.
pub struct EndingRead<T>(T);

impl<T: Read> Read for EndingRead<T> {
    fn read(&mut self, to: &mut [u8]) -> std::io::Result<usize> {
        match self.0.read(to)? {
            0 if !to.is_empty() => Err(std::io::Error::from(std::io::ErrorKind::UnexpectedEof)),
            n => Ok(n),
        }
    }
}

impl<R: Length> Length for Ending<R> {
    fn len(&self) -> u64 {
        self.0.len()
    }
}

impl<R: ChunkReader> ChunkReader for Ending<R> {
    type T = EndingRead<R::T>;

    fn get_read(&self, start: u64) -> parquet::errors::Result<Self::T> {
        self.0.get_read(start).map(EndingRead)
    }

    fn get_bytes(&self, start: u64, length: usize) -> parquet::errors::Result<Bytes> {
        self.0.get_bytes(start, length)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_list_beyond_the_end_is_refused() {
        let bytes = Bytes::from_static(&[0, 1, 2, 3]);
        let mut read = Ending(bytes).get_read(2).unwrap();
        let mut two = [0; 2];
        read.read_exact(&mut two).unwrap();
        assert_eq!(two, [2, 3]);
        let end = std::io::copy(&mut read.by_ref().take(8), &mut std::io::sink()).unwrap_err();
        assert_eq!(end.kind(), std::io::ErrorKind::UnexpectedEof);
        // nothing is asked for
        assert_eq!(read.read(&mut []).unwrap(), 0);
    }
}

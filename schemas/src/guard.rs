//! Decoders of other hands, kept from taking the program down.

use std::cell::Cell;
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

//! Work that cannot be asked to stop, given up at Ctrl-C: it must write nothing.

use crate::Interrupted;
use crate::progress::interrupted;
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::time::Duration;

/// Between two looks whether somebody wants to stop.
const LOOK: Duration = Duration::from_millis(100);

/// Does `work` on a thread of its own, which is left alone where the program is interrupted.
///
/// * `tell` is told, on this thread, what `work` tells
///
/// # Errors
/// Interrupted before it was done.
///
/// # Panics
/// Where `work` does.
pub fn interruptible<T: Send + 'static>(
    tell: &dyn Fn(&str),
    work: impl FnOnce(&dyn Fn(&str)) -> T + Send + 'static,
) -> Result<T, Interrupted> {
    let (words, said) = channel::<String>();
    let thread = std::thread::spawn(move || {
        work(&|text| {
            // nobody listens any more
            let _ = words.send(text.to_string());
        })
    });
    loop {
        let heard = said.recv_timeout(LOOK);
        if interrupted() {
            return Err(Interrupted);
        }
        match heard {
            Ok(text) => tell(&text),
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => break,
        }
    }
    thread.join().or_else(|panic| std::panic::resume_unwind(panic))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::cell::RefCell;

    #[test]
    fn prop_all_that_is_told_arrives_in_order_before_the_result() {
        let heard = RefCell::new(Vec::new());
        let result = interruptible(&|t| heard.borrow_mut().push(t.to_string()), |tell| {
            (0..100).for_each(|k| tell(&k.to_string()));
            7
        });
        assert_eq!(result.unwrap(), 7);
        let expected: Vec<String> = (0..100).map(|k| k.to_string()).collect();
        assert_eq!(heard.into_inner(), expected);
    }
}

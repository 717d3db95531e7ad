//! Frames as they lie in shared memory, taken in by the live diagnosis. A file of them holds, for each, the header's bytes, the number of
//! values that the payload has (u32), and the values.

use super::truth::{Taken, silent};
use crate::stream::announced;
use diagnoser::diagnosis::{Diagnoser, Outcome};
use diagnoser::live::{Known, Live};
use schemas::stream::frame::{BEGIN, END, FrameHeader, SAMPLES};
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

const HEADER: usize = size_of::<FrameHeader>();

/// Samples of a frame: so few that headers are a good part of the bytes.
const ROWS: usize = 30;

fn header_bytes(h: FrameHeader) -> [u8; HEADER] {
    // SAFETY: numbers and byte arrays without padding (the test below), of the same size
    unsafe { std::mem::transmute(h) }
}

fn header_of(bytes: [u8; HEADER]) -> FrameHeader {
    // SAFETY: as above; every pattern of bits is a number
    unsafe { std::mem::transmute(bytes) }
}

/// The frames of a recording.
pub(super) fn of(recording: &Path) -> Vec<u8> {
    let m = pipeline::input::open(recording, Default::default()).unwrap();
    let about = announced(&m, 5);
    let mut out = Vec::new();
    let mut add = |kind: u32, frame: u64, values: &[f64], rows: Option<(u64, usize)>| {
        let mut h = FrameHeader {
            kind,
            frame,
            stream: 77,
            publish_ns: 1000 * frame,
            ..about.header()
        };
        if let Some((first, rows)) = rows {
            h.set_rows(first, rows);
        }
        out.extend(header_bytes(h));
        out.extend((values.len() as u32).to_le_bytes());
        out.extend(values.iter().flat_map(|x| x.to_le_bytes()));
    };
    add(BEGIN, 0, &[], None);
    let (view, mut frame) = (m.telemetry.view(), 1);
    for from in (0..view.rows).step_by(ROWS) {
        let block = view.slice(from, (from + ROWS).min(view.rows));
        let mut h = about.header();
        h.set_rows(block.first, block.rows);
        let mut values = vec![0.0; h.values()];
        h.view_mut(&mut values).copy_from(&block);
        add(SAMPLES, frame, &values, Some((block.first, block.rows)));
        frame += 1;
    }
    add(END, frame, &[], None);
    out
}

/// The next frame of such a file; what is torn is as long as it is.
fn next<'a>(rest: &mut &'a [u8]) -> Option<(FrameHeader, &'a [u8])> {
    let (header, after) = rest.split_first_chunk::<HEADER>()?;
    let (length, after) = after.split_first_chunk::<4>()?;
    let bytes = (u32::from_le_bytes(*length) as usize)
        .saturating_mul(8)
        .min(after.len());
    let (payload, after) = after.split_at(bytes);
    *rest = after;
    Some((header_of(*header), payload))
}

/// Diagnoses a file of frames: every stream has one final diagnosis, and none is beside the truth.
pub(super) fn diagnose(file: &Path, known: &Known, maps: &Arc<Diagnoser>) -> Result<Taken, String> {
    let bytes = std::fs::read(file).map_err(|e| e.to_string())?;
    let mut live = Live::new(known.clone());
    let (mut rest, mut now, mut finals) = (&bytes[..], 0, BTreeMap::new());
    let (mut located, mut why) = (false, String::new());
    let mut payload = Vec::new();
    loop {
        let frame = next(&mut rest);
        now += 1_000_000;
        match &frame {
            Some((header, values)) => {
                payload.clear();
                let whole = values.chunks_exact(8);
                payload.extend(whole.map(|b| f64::from_le_bytes(b.try_into().expect("8 bytes"))));
                live.frame(header, &payload, 1, &|_| true, now);
            }
            None => live.stop(),
        }
        let wishes: Vec<_> = live.wishes().collect();
        for key in wishes {
            let serves = key.is_served_by(&maps.maps.header);
            live.maps(
                &key,
                if serves {
                    Ok(maps.clone())
                } else {
                    Err("no such maps".into())
                },
            );
        }
        while live.work() {}
        for report in live.reports() {
            if let Some(wrong) = silent(&report.diagnosis) {
                return Ok(Taken::Wrong(wrong));
            }
            if !report.is_final {
                continue;
            }
            located |= matches!(report.diagnosis.outcome, Outcome::Located(_));
            why = report.diagnosis.outcome.reason().into();
            let seen = finals.entry((report.run.actuator, report.stream)).or_insert(0);
            *seen += 1;
            if *seen > 1 {
                return Ok(Taken::Wrong("two final diagnoses of a stream".into()));
            }
        }
        if frame.is_none() {
            break;
        }
    }
    let (strays, stray) = live.strays();
    match (located, finals.is_empty(), strays) {
        (true, ..) => Ok(Taken::Right),
        (false, true, 0) => Err("no frame".into()),
        (false, true, _) => Err(stray.into()),
        (false, false, _) => Err(why),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn prop_headers_have_no_padding_and_come_back() {
        let last = FrameHeader::FIELDS.last().unwrap();
        assert_eq!(last.2 + size_of::<u32>(), HEADER);
        let sizes = |kind: &str| match kind {
            "u32" => 4,
            "u64" | "i64" | "f64" => 8,
            "[u8; 32]" => 32,
            other => panic!("{other}"),
        };
        assert_eq!(FrameHeader::FIELDS.iter().map(|f| sizes(f.1)).sum::<usize>(), HEADER);
        let h = FrameHeader {
            rate_hz: 0.1,
            process: 3,
            ..FrameHeader::default()
        };
        assert_eq!(header_of(header_bytes(h)), h);
    }
}

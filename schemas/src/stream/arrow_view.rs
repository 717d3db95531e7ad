//! A frame as Arrow arrays over the same memory.

use super::subscriber::Frame;
use crate::error::{Error, Result};
use arrow::array::{ArrayRef, Float64Array, RecordBatch};
use arrow::buffer::{Buffer, ScalarBuffer};
use arrow::datatypes::{DataType, Field, Schema};
use std::collections::HashMap;
use std::ptr::NonNull;
use std::sync::{Arc, Mutex};

impl Frame {
    /// The frame's columns as a record batch that reads the shared memory itself. The frame goes
    /// back to its publisher when the last array is dropped: keep few of them (at most
    /// [`super::MAX_BORROWED`]), and not for long.
    ///
    /// # Errors
    /// A header that [`Frame::view`] refuses.
    pub fn into_record_batch(self) -> Result<RecordBatch> {
        let fault = |e: &dyn std::fmt::Display| Error::Stream {
            service: super::TELEMETRY.into(),
            why: e.to_string(),
        };
        // a copy, as is what `view` checks: shared memory is not asked again
        let header = *self.header();
        let rows = self.view().map_err(|e| fault(&e))?.rows;
        let start = self.payload().as_ptr();
        let owner = Arc::new(Mutex::new(self));
        let mut fields = Vec::new();
        let mut columns: Vec<ArrayRef> = Vec::new();
        for (i, c) in header.channel_set().iter().enumerate() {
            let unit = HashMap::from([("unit".to_string(), c.unit().to_string())]);
            fields.push(Field::new(c.name(), DataType::Float64, false).with_metadata(unit));
            // SAFETY: `view` has checked, by the same copies of header and length, that every column of `rows`
            // values lies within the payload; the payload does not move and lives as long as its frame, which every
            // buffer owns; f64 is aligned, since columns start at multiples of 64 bytes. The samples may be written
            // by their publisher all the while (see `Frame`): any bits are an f64
            let buffer = unsafe {
                let column = start.add(i * header.stride as usize);
                let bytes = NonNull::new_unchecked(column.cast_mut().cast::<u8>());
                Buffer::from_custom_allocation(bytes, rows * size_of::<f64>(), owner.clone())
            };
            columns.push(Arc::new(Float64Array::new(ScalarBuffer::new(buffer, 0, rows), None)));
        }
        RecordBatch::try_new(Arc::new(Schema::new(fields)), columns).map_err(|e| fault(&e))
    }
}

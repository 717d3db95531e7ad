//! Tables in and out: by the Arrow PyCapsule interface and by buffers, so that no library of tables is needed.

use crate::error::{bad, to_py};
use arrow::array::{
    Array, ArrayRef, AsArray, BooleanArray, Float64Array, Int64Array, RecordBatch, RecordBatchIterator, StringArray,
    StructArray,
};
use arrow::buffer::ScalarBuffer;
use arrow::compute::{cast, concat};
use arrow::datatypes::{DataType, Field, Float64Type, Schema, SchemaRef, UInt64Type};
use arrow::ffi::{FFI_ArrowArray, FFI_ArrowSchema, from_ffi};
use arrow::ffi_stream::{FFI_ArrowArrayStream, RecordBatchStreamReader};
use pyo3::buffer::{ElementType, PyBuffer, PyUntypedBuffer};
use pyo3::exceptions::{PyBufferError, PyImportError, PyKeyError, PyTypeError};
use pyo3::ffi;
use pyo3::prelude::*;
use pyo3::types::{PyCapsule, PyDict, PyList, PyMapping, PyMemoryView, PyTuple};
use schemas::table::table_bytes;
use std::collections::HashMap;
use std::ffi::{CStr, c_int, c_void};
use std::path::PathBuf;
use std::sync::Arc;

const STREAM: &CStr = c"arrow_array_stream";
const ARRAY: &CStr = c"arrow_array";
const SCHEMA: &CStr = c"arrow_schema";

/// Columns of equal length, with metadata. polars, pandas and pyarrow read it as it is.
#[pyclass(frozen, module = "ema", mapping)]
pub struct Table {
    pub schema: SchemaRef,
    pub batches: Vec<RecordBatch>,
}

/// The values of a column, as a buffer.
#[pyclass(frozen, module = "ema")]
pub struct Column {
    values: Values,
    shape: [ffi::Py_ssize_t; 1],
}

enum Values {
    Float(ScalarBuffer<f64>),
    Single(ScalarBuffer<f32>),
    Int(ScalarBuffer<i64>),
    Unsigned(ScalarBuffer<u64>),
}

impl Values {
    /// Pointer, bytes of a value, bytes of all, format.
    fn raw(&self) -> (*const u8, usize, usize, &'static CStr) {
        fn of<T: arrow::datatypes::ArrowNativeType>(v: &ScalarBuffer<T>) -> (*const u8, usize) {
            (v.inner().as_ptr(), v.inner().len())
        }
        match self {
            Self::Float(v) => (of(v).0, 8, of(v).1, c"d"),
            Self::Single(v) => (of(v).0, 4, of(v).1, c"f"),
            Self::Int(v) => (of(v).0, 8, of(v).1, c"q"),
            Self::Unsigned(v) => (of(v).0, 8, of(v).1, c"Q"),
        }
    }
}

#[pymethods]
impl Column {
    fn __len__(&self) -> usize {
        self.shape[0] as usize
    }

    /// # Safety
    /// Python calls it with a view to be filled.
    unsafe fn __getbuffer__(slf: Bound<'_, Self>, view: *mut ffi::Py_buffer, flags: c_int) -> PyResult<()> {
        if view.is_null() {
            return Err(PyBufferError::new_err("no view"));
        }
        if flags & ffi::PyBUF_WRITABLE == ffi::PyBUF_WRITABLE {
            return Err(PyBufferError::new_err("columns are read only"));
        }
        let own = slf.get();
        let (at, size, bytes, format) = own.values.raw();
        let shape = own.shape.as_ptr().cast_mut();
        // SAFETY: the view is Python's; what it points at lives as long as the column, which it holds
        unsafe {
            (*view).buf = at.cast_mut().cast::<c_void>();
            (*view).len = bytes as ffi::Py_ssize_t;
            (*view).readonly = 1;
            (*view).itemsize = size as ffi::Py_ssize_t;
            let asked = |flag: c_int| flags & flag == flag;
            (*view).format = match asked(ffi::PyBUF_FORMAT) {
                true => format.as_ptr().cast_mut(),
                false => std::ptr::null_mut(),
            };
            (*view).ndim = 1;
            (*view).shape = if asked(ffi::PyBUF_ND) {
                shape
            } else {
                std::ptr::null_mut()
            };
            (*view).strides = match asked(ffi::PyBUF_STRIDES) {
                true => &raw mut (*view).itemsize,
                false => std::ptr::null_mut(),
            };
            (*view).suboffsets = std::ptr::null_mut();
            (*view).internal = std::ptr::null_mut();
            (*view).obj = slf.into_any().into_ptr();
        }
        Ok(())
    }
}

impl Table {
    pub fn new(schema: SchemaRef, batches: Vec<RecordBatch>) -> Self {
        Self { schema, batches }
    }

    /// Of one block.
    pub fn of(batch: RecordBatch) -> Self {
        Self::new(batch.schema(), vec![batch])
    }

    pub fn rows(&self) -> usize {
        self.batches.iter().map(RecordBatch::num_rows).sum()
    }

    /// All values of a column in one array.
    fn whole(&self, name: &str) -> PyResult<ArrayRef> {
        let missing = || {
            let names: Vec<&str> = self.schema.fields().iter().map(|f| f.name().as_str()).collect();
            PyKeyError::new_err(format!("no column `{name}`; there are {}", names.join(", ")))
        };
        let i = self.schema.index_of(name).map_err(|_| missing())?;
        let parts: Vec<&dyn Array> = self.batches.iter().map(|b| b.column(i).as_ref()).collect();
        match parts.as_slice() {
            [] => Ok(arrow::array::new_empty_array(self.schema.field(i).data_type())),
            [_] => Ok(self.batches[0].column(i).clone()),
            _ => concat(&parts).map_err(|e| PyTypeError::new_err(e.to_string())),
        }
    }

    /// The Parquet file of the table.
    pub fn bytes(&self) -> anyhow::Result<Vec<u8>> {
        let mut pairs: Vec<(String, String)> = self.schema.metadata().clone().into_iter().collect();
        pairs.sort();
        let empty = [RecordBatch::new_empty(self.schema.clone())];
        let batches = if self.batches.is_empty() {
            &empty[..]
        } else {
            &self.batches
        };
        Ok(table_bytes(batches, pairs)?)
    }
}

#[pymethods]
impl Table {
    /// A table from a dict of columns, or from anything that has the Arrow PyCapsule interface.
    #[new]
    fn make(data: &Bound<'_, PyAny>) -> PyResult<Self> {
        from_any(data)
    }

    /// Names of the columns.
    #[getter]
    fn columns(&self) -> Vec<String> {
        self.schema.fields().iter().map(|f| f.name().clone()).collect()
    }

    /// Metadata, texts by text; of tables that the package made `ema.*`, as in the files of the program.
    #[getter]
    fn metadata(&self) -> HashMap<String, String> {
        let pair = |(k, v): (&String, &String)| (k.clone(), v.clone());
        self.schema.metadata().iter().map(pair).collect()
    }

    /// Units of the columns that have one.
    #[getter]
    fn units(&self) -> HashMap<String, String> {
        let unit = |f: &Arc<Field>| Some((f.name().clone(), f.metadata().get("unit")?.clone()));
        self.schema.fields().iter().filter_map(unit).collect()
    }

    fn __len__(&self) -> usize {
        self.rows()
    }

    /// A column: a numpy array where numpy is there, else a memoryview; texts as a list. What is missing is NaN.
    fn column<'py>(&self, py: Python<'py>, name: &str) -> PyResult<Bound<'py, PyAny>> {
        let all = self.whole(name)?;
        let failed = |e: arrow::error::ArrowError| PyTypeError::new_err(e.to_string());
        let texts = || -> PyResult<Bound<'py, PyAny>> {
            let all = cast(&all, &DataType::Utf8).map_err(failed)?;
            Ok(PyList::new(py, all.as_string::<i32>().iter())?.into_any())
        };
        let values = match all.data_type() {
            _ if all.null_count() > 0 && all.data_type().is_numeric() => {
                let all = cast(&all, &DataType::Float64).map_err(failed)?;
                let all = all.as_primitive::<Float64Type>();
                Values::Float(all.iter().map(|x| x.unwrap_or(f64::NAN)).collect::<Vec<_>>().into())
            }
            DataType::Float32 => Values::Single(all.as_primitive::<arrow::datatypes::Float32Type>().values().clone()),
            DataType::Int64 => Values::Int(all.as_primitive::<arrow::datatypes::Int64Type>().values().clone()),
            DataType::UInt64 => Values::Unsigned(all.as_primitive::<UInt64Type>().values().clone()),
            t if t.is_numeric() => {
                let all = cast(&all, &DataType::Float64).map_err(failed)?;
                Values::Float(all.as_primitive::<Float64Type>().values().clone())
            }
            _ => return texts(),
        };
        let (_, size, bytes, _) = values.raw();
        let shape = [(bytes / size) as ffi::Py_ssize_t];
        let column = Bound::new(py, Column { values, shape })?.into_any();
        match py.import("numpy") {
            Ok(numpy) => numpy.call_method1("asarray", (column,)),
            Err(e) if e.is_instance_of::<PyImportError>(py) => Ok(PyMemoryView::from(&column)?.into_any()),
            Err(e) => Err(e),
        }
    }

    fn __getitem__<'py>(&self, py: Python<'py>, name: &str) -> PyResult<Bound<'py, PyAny>> {
        self.column(py, name)
    }

    /// Names of the columns, as of a dict.
    fn keys(&self) -> Vec<String> {
        self.columns()
    }

    /// All columns by name.
    fn to_dict<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let out = PyDict::new(py);
        for name in self.columns() {
            let column = self.column(py, &name)?;
            out.set_item(name, column)?;
        }
        Ok(out)
    }

    /// Writes it as a Parquet file, metadata included.
    fn save(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        let written = self.bytes().and_then(|b| Ok(schemas::error::write_whole(&path, &b)?));
        written.map_err(|e| to_py(py, e))
    }

    /// The Arrow PyCapsule interface; another schema than its own is not made.
    #[pyo3(signature = (requested_schema=None))]
    fn __arrow_c_stream__<'py>(
        &self,
        py: Python<'py>,
        requested_schema: Option<Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyCapsule>> {
        let _ = requested_schema;
        let batches: Vec<Result<RecordBatch, arrow::error::ArrowError>> =
            self.batches.iter().cloned().map(Ok).collect();
        let reader = RecordBatchIterator::new(batches, self.schema.clone());
        let stream = FFI_ArrowArrayStream::new(Box::new(reader));
        PyCapsule::new_with_value(py, stream, STREAM)
    }

    /// The Arrow PyCapsule interface.
    fn __arrow_c_schema__<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyCapsule>> {
        let schema =
            FFI_ArrowSchema::try_from(self.schema.as_ref()).map_err(|e| PyTypeError::new_err(e.to_string()))?;
        PyCapsule::new_with_value(py, schema, SCHEMA)
    }

    fn __repr__(&self) -> String {
        format!("<ema.Table, {} rows of {}>", self.rows(), self.columns().join(", "))
    }
}

/// What is neither a table nor something that a table can be made of.
fn no_table(data: &Bound<'_, PyAny>) -> PyErr {
    let kind = data.get_type().qualname().map_or("?".into(), |n| n.to_string());
    let allowed = "an object with __arrow_c_stream__ or __arrow_c_array__, or a dict of columns (arrays, buffers or lists of one length)";
    to_py(data.py(), bad("table", kind, allowed))
}

/// A table of anything that can be one.
pub fn from_any(data: &Bound<'_, PyAny>) -> PyResult<Table> {
    if let Ok(own) = data.cast::<Table>() {
        return Ok(Table::new(own.get().schema.clone(), own.get().batches.clone()));
    }
    if data.hasattr("__arrow_c_stream__")? {
        match data.call_method0("__arrow_c_stream__") {
            Ok(capsule) => return from_stream(&capsule),
            // pandas has the method, and needs pyarrow for it
            Err(e) if e.is_instance_of::<PyImportError>(data.py()) => {}
            Err(e) => return Err(e),
        }
    } else if data.hasattr("__arrow_c_array__")? {
        return from_array(&data.call_method0("__arrow_c_array__")?);
    }
    let names = match data.cast::<PyMapping>() {
        Ok(m) => m.keys()?.into_any(),
        Err(_) if data.hasattr("columns")? => data.getattr("columns")?,
        Err(_) => return Err(no_table(data)),
    };
    let (mut fields, mut columns) = (Vec::new(), Vec::<ArrayRef>::new());
    for name in names.try_iter()? {
        let name = name?;
        let text: String = name.extract().map_err(|_| no_table(data))?;
        let column = column_of(&text, &data.get_item(&name)?)?;
        if let Some(first) = columns.first().filter(|f| f.len() != column.len()) {
            let found = format!("{} values", column.len());
            let allowed = format!("{}, as in the first column", first.len());
            return Err(to_py(data.py(), bad(&format!("column `{text}`"), found, allowed)));
        }
        fields.push(Field::new(text, column.data_type().clone(), true));
        columns.push(column);
    }
    if columns.is_empty() {
        return Err(no_table(data));
    }
    let batch = RecordBatch::try_new(Arc::new(Schema::new(fields)), columns);
    Ok(Table::of(batch.map_err(|e| PyTypeError::new_err(e.to_string()))?))
}

fn from_stream(capsule: &Bound<'_, PyAny>) -> PyResult<Table> {
    let capsule = capsule.cast::<PyCapsule>()?;
    let stream = capsule.pointer_checked(Some(STREAM))?.cast::<FFI_ArrowArrayStream>();
    let failed = |e: arrow::error::ArrowError| to_py(capsule.py(), bad("table", e, "a stream of Arrow tables"));
    // SAFETY: a capsule of this name holds a stream; it is moved out, and an empty one left
    let reader = unsafe { RecordBatchStreamReader::from_raw(stream.as_ptr()) }.map_err(failed)?;
    let schema = arrow::array::RecordBatchReader::schema(&reader);
    let batches = reader.collect::<Result<Vec<_>, _>>().map_err(failed)?;
    Ok(Table::new(schema, batches))
}

fn from_array(pair: &Bound<'_, PyAny>) -> PyResult<Table> {
    let pair = pair.cast::<PyTuple>()?;
    let (schema, array) = (pair.get_item(0)?, pair.get_item(1)?);
    let schema = schema.cast::<PyCapsule>()?.pointer_checked(Some(SCHEMA))?;
    let array = array.cast::<PyCapsule>()?.pointer_checked(Some(ARRAY))?;
    let failed = |e: arrow::error::ArrowError| to_py(pair.py(), bad("table", e, "an Arrow table"));
    // SAFETY: capsules of these names hold an array and its schema; the array is moved out, and an empty one left
    let data = unsafe {
        let array = FFI_ArrowArray::from_raw(array.cast().as_ptr());
        from_ffi(array, schema.cast::<FFI_ArrowSchema>().as_ref()).map_err(failed)?
    };
    let DataType::Struct(_) = data.data_type() else {
        return Err(to_py(
            pair.py(),
            bad("table", data.data_type(), "a table: an array of structs"),
        ));
    };
    Ok(Table::of(RecordBatch::from(StructArray::from(data))))
}

/// A column of a buffer, an Arrow array or a sequence.
fn column_of(name: &str, data: &Bound<'_, PyAny>) -> PyResult<ArrayRef> {
    if let Ok(buffer) = PyUntypedBuffer::get(data)
        && let Some(column) = of_buffer(data.py(), buffer)?
    {
        return Ok(column);
    }
    // a column of pandas: numbers have a buffer behind them
    if data.hasattr("to_numpy")? && !data.hasattr("__arrow_c_stream__")? {
        let inner = data.call_method0("to_numpy")?;
        if let Ok(buffer) = PyUntypedBuffer::get(&inner)
            && let Some(column) = of_buffer(data.py(), buffer)?
        {
            return Ok(column);
        }
    }
    let mut all = Vec::new();
    let refused = |found: String| {
        let place = format!("column `{name}`");
        to_py(data.py(), bad(&place, found, "numbers, or texts"))
    };
    let iterator = data.try_iter().map_err(|_| refused(data.to_string()))?;
    for x in iterator {
        all.push(x?);
    }
    let number = |x: &Bound<'_, PyAny>| x.is_none() || x.extract::<f64>().is_ok();
    if all.iter().all(number) {
        let values = all.iter().map(|x| x.extract::<f64>().ok());
        return Ok(Arc::new(values.collect::<Float64Array>()));
    }
    let texts = all.iter().map(|x| match x.is_none() {
        true => Ok(None),
        false => x.str().map(|s| Some(s.to_string())),
    });
    Ok(Arc::new(StringArray::from(texts.collect::<PyResult<Vec<_>>>()?)))
}

/// A column of a buffer of numbers in one dimension; `None` where it is something else.
fn of_buffer(py: Python<'_>, buffer: PyUntypedBuffer) -> PyResult<Option<ArrayRef>> {
    if buffer.dimensions() != 1 {
        return Ok(None);
    }
    fn typed<T: pyo3::buffer::Element>(py: Python<'_>, buffer: PyUntypedBuffer) -> PyResult<Vec<T>> {
        let buffer: PyBuffer<T> = buffer.into_typed()?;
        buffer.to_vec(py)
    }
    let size = buffer.item_size();
    let ints = |v: Vec<i64>| -> ArrayRef { Arc::new(Int64Array::from(v)) };
    Ok(match (ElementType::from_format(buffer.format()), size) {
        (ElementType::Float { bytes: 8 }, _) => Some(Arc::new(Float64Array::from(typed::<f64>(py, buffer)?))),
        // as the sensors give them: a value of single precision is one of double precision
        (ElementType::Float { bytes: 4 }, _) => {
            let all = typed::<f32>(py, buffer)?;
            Some(Arc::new(arrow::array::Float32Array::from(all)))
        }
        (ElementType::SignedInteger { bytes: 8 }, _) => Some(ints(typed::<i64>(py, buffer)?)),
        (ElementType::SignedInteger { bytes: 4 }, _) => {
            Some(ints(typed::<i32>(py, buffer)?.into_iter().map(i64::from).collect()))
        }
        (ElementType::UnsignedInteger { bytes: 8 }, _) => {
            Some(Arc::new(arrow::array::UInt64Array::from(typed::<u64>(py, buffer)?)))
        }
        (ElementType::UnsignedInteger { bytes: 4 }, _) => {
            Some(ints(typed::<u32>(py, buffer)?.into_iter().map(i64::from).collect()))
        }
        (ElementType::Bool, 1) => {
            let all: Vec<bool> =
                typed::<u8>(py, buffer).map_or_else(|_| Vec::new(), |v| v.iter().map(|x| *x != 0).collect());
            (!all.is_empty()).then(|| -> ArrayRef { Arc::new(BooleanArray::from(all)) })
        }
        _ => None,
    })
}

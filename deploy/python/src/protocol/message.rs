//! Messages of protocols in Python: the fixed layout of a class of messages, and the bytes of one message.

use metamorph_protocol::counters::Class;
use metamorph_protocol::lattice::Cell;
use metamorph_protocol::wire::{Decoder, Encoder, HEADER, PAYLOAD, Wire, WireError};
use metamorph_world_controller::report::message_timeline::MessageLabel;
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::{PyBool, PyBytes, PyTuple, PyType};
use std::collections::BTreeSet;
use std::fmt;
use std::sync::{Mutex, PoisonError};

/// The bytes of a message.
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct Payload {
    kind: u8,
    length: u8,
    bytes: [u8; PAYLOAD],
}

impl Payload {
    fn bytes(&self) -> &[u8] {
        &self.bytes[..usize::from(self.length)]
    }
}

impl fmt::Debug for Payload {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "kind {} {:02x?}", self.kind, self.bytes())
    }
}

impl Wire for Payload {
    fn kind(&self) -> u8 {
        self.kind
    }
    fn encode(&self, out: &mut Encoder) {
        self.bytes().iter().for_each(|byte| out.u8(*byte));
    }
    fn decode(kind: u8, from: &mut Decoder<'_>) -> Result<Payload, WireError> {
        let mut payload = Payload { kind, length: 0, bytes: [0; PAYLOAD] };
        while let Ok(byte) = from.u8() {
            let at = payload.bytes.get_mut(usize::from(payload.length)).ok_or(WireError::Length)?;
            (*at, payload.length) = (byte, payload.length + 1);
        }
        Ok(payload)
    }
    fn wire_len(&self) -> usize {
        HEADER + usize::from(self.length)
    }
}

/// Returns up to eight bytes, with others behind them.
fn wide(from: &[u8], fill: u8) -> [u8; 8] {
    let mut bytes = [fill; 8];
    bytes[..from.len()].copy_from_slice(from);
    bytes
}

fn signed(from: &[u8]) -> i64 {
    let fill = if from.last().is_some_and(|b| b & 0x80 != 0) { 0xFF } else { 0 };
    i64::from_le_bytes(wide(from, fill))
}

/// The type of a field.
#[derive(Clone, Copy)]
enum Field {
    Unsigned(usize),
    Signed(usize),
    Bool,
    Cell,
    Bytes(usize),
}

impl Field {
    fn named(name: &str) -> Option<Field> {
        Some(match name {
            "u8" => Field::Unsigned(1),
            "u16" => Field::Unsigned(2),
            "u32" => Field::Unsigned(4),
            "u64" => Field::Unsigned(8),
            "i8" => Field::Signed(1),
            "i16" => Field::Signed(2),
            "i32" => Field::Signed(4),
            "i64" => Field::Signed(8),
            "bool" => Field::Bool,
            "cell" => Field::Cell,
            _ => Field::Bytes(name.strip_prefix("bytes")?.parse().ok()?),
        })
    }
    /// Returns the number of bytes.
    fn len(self) -> usize {
        match self {
            Field::Unsigned(n) | Field::Signed(n) | Field::Bytes(n) => n,
            Field::Bool => 1,
            Field::Cell => 6,
        }
    }
    /// Writes a value into `to`, which has the length of the field. Returns `None` if the value does not fit.
    fn write(self, value: &Bound<'_, PyAny>, to: &mut [u8]) -> Option<()> {
        match self {
            Field::Unsigned(n) => {
                let value: u64 = value.extract().ok()?;
                (n == 8 || value >> (8 * n) == 0).then_some(())?;
                to.copy_from_slice(&value.to_le_bytes()[..n]);
            }
            Field::Signed(n) => {
                let value: i64 = value.extract().ok()?;
                let rest = value >> (8 * n - 1);
                (rest == 0 || rest == -1).then_some(())?;
                to.copy_from_slice(&value.to_le_bytes()[..n]);
            }
            Field::Bool => to[0] = u8::from(value.cast::<PyBool>().ok()?.is_true()),
            Field::Cell => {
                let cell: (i16, i16, i16) = value.extract().ok()?;
                let cell = Cell::new(cell.0, cell.1, cell.2);
                cell.in_range().then_some(())?;
                let coordinates = <[i16; 3]>::from(cell);
                to.chunks_exact_mut(2)
                    .zip(coordinates)
                    .for_each(|(b, c)| b.copy_from_slice(&c.to_le_bytes()));
            }
            Field::Bytes(n) => {
                let bytes = value.cast::<PyBytes>().ok()?.as_bytes();
                (bytes.len() == n).then(|| to.copy_from_slice(bytes))?;
            }
        }
        Some(())
    }
    /// Returns a whole number that fits 64 bits with a sign.
    fn number(self, from: &[u8]) -> Option<i64> {
        match self {
            Field::Unsigned(_) => i64::try_from(u64::from_le_bytes(wide(from, 0))).ok(),
            Field::Signed(_) => Some(signed(from)),
            Field::Bool | Field::Cell | Field::Bytes(_) => None,
        }
    }
    fn read<'py>(self, py: Python<'py>, from: &[u8]) -> PyResult<Bound<'py, PyAny>> {
        Ok(match self {
            Field::Unsigned(_) => u64::from_le_bytes(wide(from, 0)).into_pyobject(py)?.into_any(),
            Field::Signed(_) => signed(from).into_pyobject(py)?.into_any(),
            Field::Bool => PyBool::new(py, from[0] != 0).to_owned().into_any(),
            Field::Cell => {
                let [x, y, z] = [0, 2, 4].map(|i| i16::from_le_bytes([from[i], from[i + 1]]));
                (x, y, z).into_pyobject(py)?.into_any()
            }
            Field::Bytes(_) => PyBytes::new(py, from).into_any(),
        })
    }
}

/// The names of all classes of messages that there were. Labels of messages last as long as the program.
static NAMES: Mutex<BTreeSet<&'static str>> = Mutex::new(BTreeSet::new());

/// Returns the same name for as long as the program lasts.
fn lasting(name: &str) -> &'static str {
    let mut names = NAMES.lock().unwrap_or_else(PoisonError::into_inner);
    names.get(name).copied().unwrap_or_else(|| {
        let name: &'static str = Box::leak(name.to_owned().into_boxed_str());
        names.insert(name);
        name
    })
}

/// A class of messages.
pub struct MessageType {
    class: Py<PyType>,
    name: &'static str,
    kind: u8,
    counted_as: Class,
    fields: Vec<(String, String, Field)>,
    length: usize,
}

/// Returns the class of messages with this name.
pub fn counter_class(name: &str) -> PyResult<Class> {
    Class::ALL.into_iter().find(|class| class.name() == name).ok_or_else(|| {
        let known: Vec<_> = Class::ALL.iter().map(|class| class.name()).collect();
        PyValueError::new_err(format!("`{name}` is no class of messages; write one of {}", known.join(", ")))
    })
}

impl MessageType {
    /// Reads the layout that the decorator `message` has left in a class, and checks it.
    pub fn of(class: &Bound<'_, PyType>) -> PyResult<MessageType> {
        let (kind, counted_as, layout): (u8, String, Vec<(String, String)>) =
            class.getattr("_layout")?.extract()?;
        let mut fields = Vec::new();
        for (name, kind) in layout {
            let field = Field::named(&kind)
                .ok_or_else(|| PyTypeError::new_err(format!("`{kind}` is no type of a field")))?;
            fields.push((name, kind, field));
        }
        let length = fields.iter().map(|(_, _, field)| field.len()).sum();
        if length > PAYLOAD {
            let name = class.name()?;
            let text = format!("a {name} has {length} bytes; a message has at most {PAYLOAD}");
            return Err(PyTypeError::new_err(text));
        }
        let counted_as = counter_class(&counted_as)?;
        let name = lasting(&class.name()?.to_string());
        Ok(MessageType { class: class.clone().unbind(), name, kind, counted_as, fields, length })
    }
    /// Returns the number of this kind of message.
    pub fn kind(&self) -> u8 {
        self.kind
    }
    /// Returns true if a message is of this class.
    pub fn is_type_of(&self, message: &Bound<'_, PyAny>) -> bool {
        message.get_type().is(&self.class)
    }
    /// Returns the class that messages are counted in, unless a call names another.
    pub fn counted_as(&self) -> Class {
        self.counted_as
    }
    /// Returns the label of a message of this class: its name and its first whole number.
    pub fn label(&self, payload: &Payload) -> MessageLabel {
        let mut at = 0;
        let number = self.fields.iter().find_map(|(_, _, field)| {
            let bytes = payload.bytes().get(at..at + field.len());
            at += field.len();
            field.number(bytes?)
        });
        MessageLabel { number, ..MessageLabel::of(self.name) }
    }
    /// Returns the bytes of a message of this class.
    pub fn encode(&self, message: &Bound<'_, PyAny>) -> PyResult<Payload> {
        let values = message.cast::<PyTuple>()?;
        let mut payload = Payload { kind: self.kind, length: self.length as u8, bytes: [0; PAYLOAD] };
        let mut at = 0;
        for (i, (name, kind, field)) in self.fields.iter().enumerate() {
            let value = values.get_item(i)?;
            let to = &mut payload.bytes[at..at + field.len()];
            field.write(&value, to).ok_or_else(|| {
                PyValueError::new_err(format!("the field `{name}` of {message} is no {kind}"))
            })?;
            at += field.len();
        }
        Ok(payload)
    }
    /// Returns the message with these bytes; `make` is `tuple.__new__`.
    pub fn decode<'py>(
        &self,
        py: Python<'py>,
        payload: &Payload,
        make: &Py<PyAny>,
    ) -> PyResult<Bound<'py, PyAny>> {
        if usize::from(payload.length) != self.length {
            return Err(PyValueError::new_err("the length of a message does not match its class"));
        }
        let (mut values, mut at) = (Vec::with_capacity(self.fields.len()), 0);
        for (_, _, field) in &self.fields {
            values.push(field.read(py, &payload.bytes[at..at + field.len()])?);
            at += field.len();
        }
        make.bind(py).call1((&self.class, PyTuple::new(py, values)?))
    }
}

/// Checks the layout of a class of messages.
#[pyfunction]
pub fn check_message(class_: &Bound<'_, PyType>) -> PyResult<()> {
    MessageType::of(class_).map(drop)
}

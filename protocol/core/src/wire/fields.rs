//! Values within a payload, and macros that write the codec of a message from the list of its fields.

use super::{Decoder, Encoder, WireError};
use crate::ids::{Incarnation, ModuleId, Port, Session, Token};
use crate::lattice::{Cell, Face};
use crate::time::{Span, Time};

/// A value within a payload. Implement it by [`fields!`](crate::fields), [`choice!`](crate::choice) or
/// [`codes!`](crate::codes) where every field is written as it is, and by hand where a message packs or checks more.
pub trait Field: Sized {
    /// Writes the value.
    fn put(&self, out: &mut Encoder);
    /// Reads a value and checks it.
    ///
    /// # Errors
    /// If the payload has ended, or the value is impossible; `name` is the field that the error names.
    fn take(name: &'static str, from: &mut Decoder<'_>) -> Result<Self, WireError>;
}

/// A value with a pattern of bits that stands for its absence.
pub trait Absent: Field {
    /// Writes that there is no value.
    fn put_none(out: &mut Encoder);
    /// Reads a value, or that there is none.
    ///
    /// # Errors
    /// Those of [`Field::take`].
    fn take_option(name: &'static str, from: &mut Decoder<'_>) -> Result<Option<Self>, WireError>;
}

impl<T: Absent> Field for Option<T> {
    #[inline]
    fn put(&self, out: &mut Encoder) {
        match self {
            Some(value) => value.put(out),
            None => T::put_none(out),
        }
    }
    #[inline]
    fn take(name: &'static str, from: &mut Decoder<'_>) -> Result<Option<T>, WireError> {
        T::take_option(name, from)
    }
}

macro_rules! numbers {
    ($($number:ty),*) => { $(
        impl Field for $number {
            #[inline]
            fn put(&self, out: &mut Encoder) {
                out.put(&self.to_le_bytes());
            }
            #[inline]
            fn take(_: &'static str, from: &mut Decoder<'_>) -> Result<$number, WireError> {
                Ok(<$number>::from_le_bytes(from.take()?))
            }
        }
    )* };
}
numbers!(u8, i8, u16, i16, u32, i32, u64, u128);

macro_rules! newtypes {
    ($($name:ident),*) => { $(
        impl Field for $name {
            #[inline]
            fn put(&self, out: &mut Encoder) {
                self.0.put(out);
            }
            #[inline]
            fn take(name: &'static str, from: &mut Decoder<'_>) -> Result<$name, WireError> {
                Field::take(name, from).map($name)
            }
        }
    )* };
}
newtypes!(Incarnation, ModuleId, Port, Session, Span, Time, Token);

impl Field for bool {
    #[inline]
    fn put(&self, out: &mut Encoder) {
        out.bool(*self);
    }
    #[inline]
    fn take(name: &'static str, from: &mut Decoder<'_>) -> Result<bool, WireError> {
        from.bool(name)
    }
}

impl Field for Cell {
    #[inline]
    fn put(&self, out: &mut Encoder) {
        out.cell(*self);
    }
    #[inline]
    fn take(_: &'static str, from: &mut Decoder<'_>) -> Result<Cell, WireError> {
        from.cell()
    }
}

impl Field for Face {
    #[inline]
    fn put(&self, out: &mut Encoder) {
        out.face(*self);
    }
    #[inline]
    fn take(name: &'static str, from: &mut Decoder<'_>) -> Result<Face, WireError> {
        from.face(name)
    }
}

impl<T: Field, const N: usize> Field for [T; N]
where
    [T; N]: Default,
{
    #[inline]
    fn put(&self, out: &mut Encoder) {
        self.iter().for_each(|value| value.put(out));
    }
    #[inline]
    fn take(name: &'static str, from: &mut Decoder<'_>) -> Result<[T; N], WireError> {
        let mut all = <[T; N]>::default();
        for value in &mut all {
            *value = T::take(name, from)?;
        }
        Ok(all)
    }
}

macro_rules! tuples {
    ($(($($name:ident),+)),+) => { $(
        impl<$($name: Field),+> Field for ($($name,)+) {
            #[inline]
            fn put(&self, out: &mut Encoder) {
                #[expect(non_snake_case, reason = "a value is called like its type")]
                let ($($name,)+) = self;
                $($name.put(out);)+
            }
            #[inline]
            fn take(name: &'static str, from: &mut Decoder<'_>) -> Result<($($name,)+), WireError> {
                Ok(($($name::take(name, from)?,)+))
            }
        }
    )+ };
}
tuples!((A, B), (A, B, C), (A, B, C, D, E, F, G));

/// No token is written as 0.
impl Absent for Token {
    #[inline]
    fn put_none(out: &mut Encoder) {
        out.u32(0);
    }
    #[inline]
    fn take_option(name: &'static str, from: &mut Decoder<'_>) -> Result<Option<Token>, WireError> {
        Ok(Some(Token::take(name, from)?).filter(|token| token.0 != 0))
    }
}

/// No module is written as the largest number.
impl Absent for ModuleId {
    #[inline]
    fn put_none(out: &mut Encoder) {
        out.u32(u32::MAX);
    }
    #[inline]
    fn take_option(name: &'static str, from: &mut Decoder<'_>) -> Result<Option<ModuleId>, WireError> {
        Ok(Some(ModuleId::take(name, from)?).filter(|id| id.0 != u32::MAX))
    }
}

/// Implements [`Field`](crate::wire::Field) for a struct: its fields in this order. A name after a field is the one that
/// errors give it.
#[macro_export]
macro_rules! fields {
    ($type:ident { $($field:tt $(as $name:literal)?),+ $(,)? }) => {
        impl $crate::wire::Field for $type {
            #[inline]
            fn put(&self, out: &mut $crate::wire::Encoder) {
                $($crate::wire::Field::put(&self.$field, out);)+
            }
            #[inline]
            fn take(_: &'static str, from: &mut $crate::wire::Decoder<'_>) -> Result<Self, $crate::wire::WireError> {
                Ok($type { $($field: $crate::wire::Field::take($crate::field_name!($field $($name)?), from)?),+ })
            }
        }
    };
}

/// Implements [`Wire`](crate::wire::Wire) for a type that is a [`Field`](crate::wire::Field): the only kind of message in
/// its place.
#[macro_export]
macro_rules! only_message {
    ($type:ident = $kind:literal) => {
        impl $crate::wire::Wire for $type {
            fn kind(&self) -> u8 {
                $kind
            }
            fn encode(&self, out: &mut $crate::wire::Encoder) {
                $crate::wire::Field::put(self, out);
            }
            fn decode(
                kind: u8,
                from: &mut $crate::wire::Decoder<'_>,
            ) -> Result<Self, $crate::wire::WireError> {
                if kind == $kind {
                    $crate::wire::Field::take("", from)
                } else {
                    Err($crate::wire::WireError::Kind(kind))
                }
            }
        }
    };
}

/// Implements [`Wire`](crate::wire::Wire) for an enum: a kind of message for each variant, with its fields in this order.
/// A condition after a variant, with the field that is wrong otherwise, is checked when it has been read. Other methods of
/// the trait may follow.
#[macro_export]
macro_rules! messages {
    ($type:ident { $(
        $kind:literal => $variant:ident
            $(($($inner:ident $(as $inner_name:literal)?),+))?
            $({$($field:ident $(as $name:literal)?),+ $(,)?})?
            $(if $check:expr => $wrong:literal)*
    ),+ $(,)? } $($other:tt)*) => {
        impl $crate::wire::Wire for $type {
            fn kind(&self) -> u8 {
                match self {
                    $($type::$variant { .. } => $kind,)+
                }
            }
            fn encode(&self, out: &mut $crate::wire::Encoder) {
                match self {
                    $($type::$variant $(($($inner),+))? $({ $($field),+ })? => {
                        $($($crate::wire::Field::put($inner, out);)+)?
                        $($($crate::wire::Field::put($field, out);)+)?
                    })+
                }
            }
            fn decode(kind: u8, from: &mut $crate::wire::Decoder<'_>) -> Result<Self, $crate::wire::WireError> {
                Ok(match kind {
                    $($kind => {
                        $($(let $inner = $crate::wire::Field::take($crate::field_name!($inner $($inner_name)?), from)?;)+)?
                        $($(let $field = $crate::wire::Field::take($crate::field_name!($field $($name)?), from)?;)+)?
                        let message = $type::$variant $(($($inner),+))? $({ $($field),+ })?;
                        $(if !$check {
                            return Err($crate::wire::WireError::Field($wrong));
                        })*
                        message
                    })+
                    _ => return Err($crate::wire::WireError::Kind(kind)),
                })
            }
            $($other)*
        }
    };
}

/// Implements [`Field`](crate::wire::Field) for an enum: the number of a variant as one byte, then its fields in this
/// order. The text is the field that is wrong if there is no such number.
#[macro_export]
macro_rules! choice {
    ($type:ident, $wrong:literal { $(
        $number:literal => $variant:ident $({$($field:ident $(as $name:literal)?),+ $(,)?})?
    ),+ $(,)? }) => {
        impl $crate::wire::Field for $type {
            fn put(&self, out: &mut $crate::wire::Encoder) {
                match self {
                    $($type::$variant $({ $($field),+ })? => {
                        out.u8($number);
                        $($($crate::wire::Field::put($field, out);)+)?
                    })+
                }
            }
            fn take(_: &'static str, from: &mut $crate::wire::Decoder<'_>) -> Result<Self, $crate::wire::WireError> {
                Ok(match from.u8()? {
                    $($number => $type::$variant $({
                        $($field: $crate::wire::Field::take($crate::field_name!($field $($name)?), from)?),+
                    })?,)+
                    _ => return Err($crate::wire::WireError::Field($wrong)),
                })
            }
        }
    };
}

/// Implements [`Field`](crate::wire::Field) for an enum without fields: its number as one byte. With `or none` the byte 0
/// stands for no value.
#[macro_export]
macro_rules! codes {
    ($type:ident, $wrong:literal { $($variant:ident),+ $(,)? }) => {
        impl $crate::wire::Field for $type {
            #[inline]
            fn put(&self, out: &mut $crate::wire::Encoder) {
                out.u8(*self as u8);
            }
            #[inline]
            fn take(_: &'static str, from: &mut $crate::wire::Decoder<'_>) -> Result<Self, $crate::wire::WireError> {
                let code = from.u8()?;
                $(if code == $type::$variant as u8 {
                    return Ok($type::$variant);
                })+
                Err($crate::wire::WireError::Field($wrong))
            }
        }
    };
    ($type:ident or none, $wrong:literal { $($variant:ident),+ $(,)? }) => {
        $crate::codes!($type, $wrong { $($variant),+ });
        impl $crate::wire::Absent for $type {
            #[inline]
            fn put_none(out: &mut $crate::wire::Encoder) {
                out.u8(0);
            }
            #[inline]
            fn take_option(
                _: &'static str,
                from: &mut $crate::wire::Decoder<'_>,
            ) -> Result<Option<Self>, $crate::wire::WireError> {
                let code = from.u8()?;
                $(if code == $type::$variant as u8 {
                    return Ok(Some($type::$variant));
                })+
                if code == 0 { Ok(None) } else { Err($crate::wire::WireError::Field($wrong)) }
            }
        }
    };
}

/// Returns the name of a field in errors: the given one, or else its own.
#[doc(hidden)]
#[macro_export]
macro_rules! field_name {
    ($field:tt) => {
        stringify!($field)
    };
    ($field:tt $name:literal) => {
        $name
    };
}

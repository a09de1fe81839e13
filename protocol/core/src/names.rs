//! Macros for enums without fields: the list of all values, and their names in scenarios and reports.

/// Gives an enum `ALL`, in the order of its values, and `name`.
#[macro_export]
macro_rules! names {
    ($type:ident { $($value:ident => $name:literal),+ $(,)? }) => {
        impl $type {
            /// All values, in their order.
            pub const ALL: [$type; [$($name),+].len()] = [$($type::$value),+];

            /// Returns the name in scenarios, files and reports.
            pub const fn name(self) -> &'static str {
                match self {
                    $($type::$value => $name),+
                }
            }
        }
    };
}

/// Defines an enum with `ALL`, in the order of its values.
#[macro_export]
macro_rules! listed {
    ($(#[$meta:meta])* pub enum $type:ident { $($(#[$doc:meta])* $value:ident,)+ }) => {
        $(#[$meta])*
        pub enum $type {
            $($(#[$doc])* $value,)+
        }

        impl $type {
            /// All values, in their order.
            pub const ALL: [$type; [$(stringify!($value)),+].len()] = [$($type::$value),+];
        }
    };
}

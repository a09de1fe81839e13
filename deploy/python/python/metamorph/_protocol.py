"""Protocols written in Python: one object per module, on the simulated link."""

from __future__ import annotations

from collections import namedtuple
from typing import (
    TYPE_CHECKING,
    Annotated,
    Any,
    Callable,
    ClassVar,
    Generic,
    Mapping,
    NamedTuple,
    Optional,
    Sequence,
    Tuple,
    TypeVar,
    Union,
    get_type_hints,
)

from . import _metamorph as _native

if TYPE_CHECKING:
    from typing_extensions import dataclass_transform
else:

    def dataclass_transform(**_: Any) -> Any:
        return lambda decorator: decorator


#: Whole numbers of fixed width, for the fields of messages.
u8 = Annotated[int, "u8"]
u16 = Annotated[int, "u16"]
u32 = Annotated[int, "u32"]
u64 = Annotated[int, "u64"]
i8 = Annotated[int, "i8"]
i16 = Annotated[int, "i16"]
i32 = Annotated[int, "i32"]
i64 = Annotated[int, "i64"]
#: A cell of the lattice: x, y, z.
cell = Annotated[Tuple[int, int, int], "cell"]

_T = TypeVar("_T")
_Value = TypeVar("_Value", bound=Union[str, int])


def _field(name: str, hint: Any) -> str:
    marks: tuple[Any, ...] = getattr(hint, "__metadata__", ())
    if hint is bool:
        return "bool"
    if marks and hint.__origin__ is bytes and isinstance(marks[0], int):
        return f"bytes{marks[0]}"
    if marks and isinstance(marks[0], str):
        return marks[0]
    raise TypeError(
        f"the field `{name}` has no fixed layout; its type is one of u8 to u64, i8 to i64, bool, cell, or"
        " Annotated[bytes, N] for N bytes"
    )


def _equal(self: Any, other: Any) -> bool:
    return type(self) is type(other) and bool(tuple.__eq__(self, other))


def _unequal(self: Any, other: object) -> bool:
    return not self == other


@dataclass_transform(frozen_default=True)
def message(*, kind: int, cls: str) -> Callable[[type[_T]], type[_T]]:
    """Makes a class a kind of message: its fields have a fixed layout, little endian, of at most 96 bytes.

    Messages cannot be changed; they are equal if class and fields are.

    :param kind: the number of the kind, from 0 to 255, different for each of a protocol.
    :param cls: the class that its messages are counted in, such as `"seed"`.
    """

    def decorate(wrapped: type[_T]) -> type[_T]:
        hints = get_type_hints(wrapped, include_extras=True)
        layout = [(name, _field(name, hint)) for name, hint in hints.items()]
        own = dict(vars(wrapped))
        defaults = [own.pop(name) for name in hints if name in own]
        base = namedtuple(wrapped.__name__, list(hints), defaults=defaults)  # type: ignore[misc]
        body = {key: value for key, value in own.items() if key not in ("__dict__", "__weakref__")}
        body.update(__slots__=(), _layout=(kind, cls, layout), __eq__=_equal, __ne__=_unequal, __hash__=tuple.__hash__)
        made: type[_T] = type(wrapped.__name__, (base,), body)
        _native.check_message(made)
        return made

    return decorate


class Param(Generic[_Value]):
    """A parameter of a protocol with its default. A scenario sets it in `[protocol]`, a call by
    `set={"protocol.repeat": "1s"}`, and a sweep varies it."""

    def __init__(self, default: _Value) -> None:
        self.default = default

    def __get__(self, instance: object, owner: Optional[type] = None) -> _Value:
        return self.default


class Percept(NamedTuple):
    """What a body tells about a move."""

    #: `"arrived"`, `"failed"` or `"refused"`.
    kind: str
    #: The new cell, if it has arrived.
    cell: Optional[tuple[int, int, int]]
    #: Why it was refused: `"blocked"`, `"late"`, `"stale"` or `"moving"`.
    why: Optional[str]


class Protocol:
    """The protocol of one module. Each module has an object of its own; all it keeps in attributes is its state.

    The state must be the same on every machine: int, bool, str, bytes, None, messages, and tuples, lists, dicts and sets
    of these. A class that keeps other things returns its state from :meth:`state`. Clocks, `random`, `hash` and the order
    of a set differ from run to run; :func:`check_determinism` finds their use.
    """

    #: The classes of its messages.
    messages: ClassVar[Sequence[type]] = ()

    def __init__(self, id: int, incarnation: int, place: tuple[int, int, int]) -> None:
        """Called when the process of the module starts.

        :param id: the number of the module.
        :param incarnation: how often it was restarted. Above 0 it has lost its memory.
        :param place: the cell of its body.
        """
        self.id = id
        self.incarnation = incarnation
        self.place = place

    def start(self, ctx: _native.Context) -> None:
        """The process has started. The contacts follow."""

    def contact(self, ctx: _native.Context, port: int, up: bool) -> None:
        """Another module touches a port, or does no longer. Ports: 0 east, 1 west, 2 north, 3 south, 4 up, 5 down."""

    def receive(self, ctx: _native.Context, port: int, message: Any) -> None:
        """A message has come by a port."""

    def sensed(self, ctx: _native.Context, percept: Percept) -> None:
        """The body tells how a move went."""

    def wake(self, ctx: _native.Context) -> None:
        """The time of the timer has come. The timer is off until it is set again."""

    def state(self) -> Any:
        """The state, for the state hash: by default all attributes."""
        return vars(self)


#: Called with the last reports of living modules by number, and the time in seconds, after every report and death, and
#: every `move_time`. Returns None to go on, True for `"built"`, or the name of an outcome.
Until = Callable[[Mapping[int, Any], float], Union[None, bool, str]]
#: Called with the objects of living modules by number, and the time in seconds, at every audit. Returns what is wrong.
Invariant = Callable[[Mapping[int, Any], float], Optional[str]]


def _parameters(cls: type[Protocol]) -> dict[str, Param[Any]]:
    return {
        name: value for base in reversed(cls.__mro__) for name, value in vars(base).items() if isinstance(value, Param)
    }


def _wrong(cls: type[Protocol], name: str, value: Any) -> Optional[tuple[str, str]]:
    """What is wrong with a value of a parameter, and what to do; called by the extension."""
    known = _parameters(cls)
    if name not in known:
        names = ", ".join(f"`{n}`" for n in known) or "none"
        return f"{cls.__name__} has no parameter `{name}`", f"the parameters are {names}"
    default = known[name].default
    if type(value) is not type(default):
        return f"the parameter `{name}` is {value!r}", f"write a value like its default, {default!r}"
    if isinstance(default, str) and _is_duration(default) and not _is_duration(value):
        return f"the parameter `{name}` is {value!r}, which is no time", f"write a time such as {default!r}"
    return None


def _is_duration(text: str) -> bool:
    try:
        _native.nanoseconds(text)
    except ValueError:
        return False
    return True


def _bind(cls: type[Protocol], values: Mapping[str, Any]) -> type[Protocol]:
    """The class with values for its parameters; called by the extension."""
    defaults = {name: param.default for name, param in _parameters(cls).items()}
    body = {"__module__": cls.__module__, "__qualname__": cls.__qualname__, **defaults, **values}
    make: Any = type(cls)
    bound: type[Protocol] = make(cls.__name__, (cls,), body)
    return bound


def _given(
    protocol: Optional[type[Protocol]], until: Optional[Until], invariants: Sequence[Invariant], every: Optional[str]
) -> Optional[_native.Protocol]:
    if protocol is None:
        if until is not None or invariants or every is not None:
            raise ValueError(
                "`until`, `invariants` and `every` are for a protocol written in Python; pass `protocol=` as well"
            )
        return None
    if not (isinstance(protocol, type) and issubclass(protocol, Protocol)):
        raise TypeError("protocol is a class that derives from metamorph.Protocol")
    named = [(getattr(check, "__name__", "invariant"), check) for check in invariants]
    return _native.Protocol(protocol, until, named, every)

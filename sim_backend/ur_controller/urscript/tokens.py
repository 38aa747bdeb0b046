"""Tokens of URScript, and the error of a script."""

from __future__ import annotations

import re
from dataclasses import dataclass
from enum import Enum, auto

from toolee_robot.errors import TooleeError


class ScriptError(TooleeError):
    """A script does not parse, or failed while it ran.

    Args:
        message: What happened.
        line: Line of the script, 1-based; 0 if unknown.

    Attributes:
        line: Line of the script, 1-based; 0 if unknown.
    """

    def __init__(self, message: str, line: int = 0) -> None:
        super().__init__(f"line {line}: {message}" if line else message)
        self.line = line


KEYWORDS = frozenset(
    {
        *("def", "sec", "thread", "end", "if", "elif", "else", "while", "return", "break", "continue", "global"),
        *("local", "run", "kill", "join", "enter_critical", "exit_critical", "halt", "True", "False"),
        *("and", "or", "xor", "not"),
    }
)
INT_MAX = 2**31 - 1
DEPTH = 40
"""Largest nesting depth of blocks and brackets."""


class Kind(Enum):
    """Kind of a token."""

    NUMBER = auto()
    STRING = auto()
    NAME = auto()
    WORD = auto()
    """A keyword or an operator."""
    END = auto()


@dataclass(frozen=True, slots=True)
class Token:
    """A token.

    Attributes:
        kind: Kind of the token.
        text: Its text; of a string, without the quotes.
        line: Line of the script, 1-based.
    """

    kind: Kind
    text: str
    line: int


_PATTERN = re.compile(
    r"""(?P<space>[ \t\r\f\v]+|\#[^\n]*)
    |(?P<newline>\n)
    |(?P<NUMBER>0[xX][0-9a-fA-F]+|(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?)
    |(?P<STRING>"[^"\n]*")
    |(?P<NAME>[A-Za-z_][A-Za-z0-9_]*)
    |(?P<sign>==|!=|<=|>=|[-+*/%<>=()\[\],:$])""",
    re.VERBOSE,
)


def tokenise(source: str) -> list[Token]:
    """Split a script into tokens.

    Args:
        source: The script.

    Returns:
        The tokens, the last of kind END.

    Raises:
        ScriptError: There is a character that does not belong to the language.
    """
    tokens: list[Token] = []
    line, at = 1, 0
    while at < len(source):
        match = _PATTERN.match(source, at)
        if match is None:
            raise ScriptError(f"unexpected {source[at]!r}", line)
        at, text = match.end(), match.group()
        if match.lastgroup == "newline":
            line += 1
        elif match.lastgroup == "NUMBER":
            tokens.append(Token(Kind.NUMBER, text, line))
        elif match.lastgroup == "STRING":
            tokens.append(Token(Kind.STRING, text[1:-1], line))
        elif match.lastgroup == "NAME":
            tokens.append(Token(Kind.WORD if text in KEYWORDS else Kind.NAME, text, line))
        elif match.lastgroup == "sign":
            tokens.append(Token(Kind.WORD, text, line))
    tokens.append(Token(Kind.END, "end of the script", line))
    return tokens


def number(token: Token) -> int | float:
    """Value of a NUMBER token.

    Args:
        token: The token.

    Returns:
        A 32-bit integer or a float.

    Raises:
        ScriptError: The number is out of range.
    """
    text = token.text
    if text[:2] in ("0x", "0X"):
        value: int | float = int(text, 16)
    elif text.isdigit():
        value = int(text) if len(text) < 12 else INT_MAX + 1
    else:
        value = float(text)
    if value > INT_MAX and (isinstance(value, int) or value == float("inf")):
        raise ScriptError(f"the number {text[:20]} is too large", token.line)
    return value


class TokenReader:
    """Reads a list of tokens from its start to its end; the base class of the parser.

    Args:
        tokens: The tokens, the last of kind END.
    """

    def __init__(self, tokens: list[Token]) -> None:
        self._tokens, self._at, self._depth = tokens, 0, 0

    def _peek(self, ahead: int = 0) -> Token:
        """The token `ahead` tokens after the next one."""
        return self._tokens[min(self._at + ahead, len(self._tokens) - 1)]

    def _next(self) -> Token:
        """Take the next token."""
        token = self._peek()
        self._at += 1
        return token

    def _is(self, *words: str) -> bool:
        """Whether the next token is one of these keywords or operators."""
        token = self._peek()
        return token.kind is Kind.WORD and token.text in words

    def _accept(self, word: str) -> bool:
        """Take the next token if it is this keyword or operator; returns whether it was."""
        if self._is(word):
            self._at += 1
            return True
        return False

    def _expect(self, word: str) -> Token:
        """Take the next token; raises ScriptError unless it is this keyword or operator."""
        if not self._is(word):
            raise self._unexpected(f"'{word}'")
        return self._next()

    def _name(self) -> str:
        """Take a name; raises ScriptError unless the next token is one."""
        if self._peek().kind is not Kind.NAME:
            raise self._unexpected("a name")
        return self._next().text

    def _unexpected(self, wanted: str) -> ScriptError:
        """The error for the next token, where `wanted` was expected."""
        token = self._peek()
        return ScriptError(f"expected {wanted}, found {token.text[:40]!r}", token.line)

    def _deeper(self) -> None:
        """Enter a block or bracket; raises ScriptError beyond DEPTH."""
        self._depth += 1
        if self._depth > DEPTH:
            raise ScriptError("nested too deeply", self._peek().line)

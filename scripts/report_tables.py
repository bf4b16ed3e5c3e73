"""What the reports in Python share: Markdown tables, numbers in them, JSON to read, and one clear line on bad input.

Installed next to the scripts that import it; experiments/common.py brings it to the experiments.
"""
import contextlib
import json
import os
import sys


def fail(text):
    """Ends the program with status 1 and one line on stderr: its name and the text."""
    sys.exit("%s: %s" % (os.path.basename(sys.argv[0]), " ".join(text.splitlines())))


@contextlib.contextmanager
def one_line_about(path):
    """Fails with a line about the file `path` when the block cannot open it, or does not find what should be in it.

    Takes OSError, ValueError, KeyError, TypeError, IndexError and StopIteration: what a file of another kind leads to.
    """
    try:
        yield
    except OSError as error:  # another file that the block opens is named by the error
        fail("%s: %s" % (error.filename or path, error.strerror or error))
    except KeyError as error:
        fail("%s: there is no %s in it" % (path, error))
    except (ValueError, TypeError, IndexError, StopIteration) as error:
        fail("%s: %s" % (path, str(error) or type(error).__name__))


def read_json(path):
    """The value that a JSON file holds. Fails with a line about the file when it cannot be read."""
    with one_line_about(path), open(path, encoding="utf-8") as file:
        return json.load(file)


def number(value, digits=1, factor=1):
    """factor * value with so many digits after the point; "-" for None."""
    return "-" if value is None else "%.*f" % (digits, factor * value)


def table(header, rows, aligned=False):
    """Lines of a Markdown table, without an end of line.

    header: n >= 1 texts. rows: each n texts, or what str() makes texts of; ValueError otherwise. aligned: cells are
    filled up with spaces, so that columns can be read in the source, too.
    """
    rows = [[str(cell) for cell in row] for row in rows]
    for row in rows:
        if len(row) != len(header):
            raise ValueError("a row of %d cells in a table of %d columns: %s" % (len(row), len(header), row))
    if aligned:
        widths = [max(map(len, column)) for column in zip(header, *rows)]
        rows = [[cell.ljust(width) for cell, width in zip(row, widths)] for row in [header, *rows]]
        return ["| " + " | ".join(row) + " |" for row in [rows[0], ["-" * width for width in widths], *rows[1:]]]
    return ["|" + "".join(" %s |" % cell if cell else " |" for cell in row)
            for row in [header, ["---"] * len(header), *rows]]


def titled_table(title, header, rows):
    """A line and the aligned table below it, as one text without an end of line."""
    return "\n".join([title, "", *table(header, rows, aligned=True)])


def replace_marked(path, name, text):
    """Puts the text between the lines "<!-- NAME: begin -->" and "<!-- NAME: end -->" of a document.

    Fails with a line about the file when it lacks them.
    """
    begin, end = "<!-- %s: begin -->" % name, "<!-- %s: end -->" % name
    with one_line_about(path), open(path, encoding="utf-8") as file:
        before, _, rest = file.read().partition(begin)
    _, mark, after = rest.partition(end)
    if not mark:
        fail("%s lacks the lines %s and %s" % (path, begin, end))
    with one_line_about(path), open(path, "w", encoding="utf-8") as file:
        file.write("%s%s\n\n%s\n%s%s" % (before, begin, text, end, after))


def add_table_arguments(parser):
    """The options of a report's tables: --markdown and --document. See write_tables."""
    parser.add_argument("--markdown", help="where to write the tables")
    parser.add_argument("--document", help="file whose part between two marks becomes the tables")


def write_tables(arguments, name, text, below=""):
    """Writes the text where add_table_arguments' options say; into the document with what stands below it there."""
    if arguments.markdown:
        with one_line_about(arguments.markdown), open(arguments.markdown, "w", encoding="utf-8") as file:
            file.write(text)
    if arguments.document:
        replace_marked(arguments.document, name, text + below)

"""Configuration of Sphinx; `make docs` builds the site."""

import re

project = "torch_radbp"
author = copyright = "the authors of torch_radbp"

extensions = ["myst_parser"]
myst_enable_extensions = ["colon_fence", "fieldlist"]
myst_heading_anchors = 3
exclude_patterns = ["**.py"]
maximum_signature_line_length = 90
nitpicky = True  # a name that is referred to must be there
nitpick_ignore_regex = [("py:class", ".*")]  # but for the annotations of signatures
python_use_unqualified_type_names = True
add_module_names = False

html_theme = "furo"  # fonts of the reader's system: nothing is fetched from elsewhere
html_title = "torch_radbp"
html_static_path = ["_static"]
html_css_files = ["wide_tables.css"]
html_show_sphinx = False
html_copy_source = False


def with_breaks(app, page, template, context, doctree):
    """Lets tables break long names of code at their dots and underscores rather than anywhere."""
    body = re.sub(r'(?<=<span class="pre">)[^<]+', lambda name: re.sub(r"(?<=\w[._/(,=])(?=\w)", "<wbr>", name[0]),
                  context.get("body", ""))
    context["body"] = body.replace('<span class="sig-paren">(</span>', '<span class="sig-paren">(</span><wbr>')


def setup(app):
    """Registers what is done with each page."""
    app.connect("html-page-context", with_breaks)

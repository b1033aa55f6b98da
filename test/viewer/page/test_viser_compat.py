from html.parser import HTMLParser

from omniman_ros.viewer.page.viser_compat import script_html, style_html


class Elements(HTMLParser):
    """Collects the elements of some HTML with their attributes."""

    def __init__(self):
        super().__init__()
        self.found = []

    def handle_starttag(self, tag, attributes):
        self.found.append((tag, dict(attributes)))


def elements(html):
    parser = Elements()
    parser.feed(html)
    return parser.found


def test_a_script_with_quotes_and_markup_remains_one_attribute():
    script = """if (a < b && c) { d("&quot;", '<b>'); }"""
    ((tag, attributes),) = elements(script_html(script))
    assert tag == "img"
    assert attributes["onerror"] == script


def test_rules_are_joined_in_one_style_element():
    assert style_html("a{}", "b{}") == "<style>a{}b{}</style>"

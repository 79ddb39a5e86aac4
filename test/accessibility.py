"""Faults of accessibility in a page that a browser shows."""

from aids import axe

RULES = ("wcag2a", "wcag2aa", "wcag21a", "wcag21aa")
"""What is asked of a page: WCAG 2.1, levels A and AA."""
SCROLLING = """() => [...document.querySelectorAll("body *")]
  .filter((e) => e.checkVisibility() && !(e instanceof SVGElement))
  .filter((e) => /auto|scroll/.test(getComputedStyle(e).overflow))
  .map((e) => ({
    place: e.outerHTML.slice(0, 120),
    reached: e.tabIndex === 0,
    named: Boolean(e.getAttribute("aria-label") || e.getAttribute("aria-labelledby")),
    role: e.getAttribute("role"),
  }))"""


def assert_reachable(page):
    """Fail unless the keyboard reaches everything that may scroll, and it has role and name."""
    found = page.evaluate(SCROLLING)
    assert found
    assert [e for e in found if not (e["reached"] and e["named"] and e["role"])] == []


def assert_accessible(page):
    """Fail for every fault that axe-core finds; skip the test where it is not installed."""
    page.evaluate(axe())
    found = page.evaluate("tags => axe.run({runOnly: {type: 'tag', values: tags}})", RULES)
    faults = [
        (fault["id"], node["html"][:120])
        for fault in found["violations"]
        for node in fault["nodes"]
    ]
    assert faults == []
    assert any(rule["id"] == "document-title" for rule in found["passes"])

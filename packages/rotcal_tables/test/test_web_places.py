"""What the scripts of the page fill is on the page."""

from test_page_looks import require_filled_places

from rotcal_tables.web import STATIC


def test_every_place_that_the_scripts_of_the_page_fill_is_there():
    require_filled_places(STATIC / "web.html", STATIC.glob("*.js"))

"""``exumi stats --html``: a page by which a stranger can judge a dataset in a minute."""

from exumi_data.stats.html.judgement import Finding, Judgement, NotJudged
from exumi_data.stats.html.making import check_target, page_of, write_page

__all__ = ["Finding", "Judgement", "NotJudged", "check_target", "page_of", "write_page"]

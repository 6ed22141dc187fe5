"""The report in a real browser: figures have a size, schemes differ, nothing overflows."""

import json
import re
import shutil
import subprocess

import numpy as np
import pytest

from polar_nav_tools.report import render
from polar_nav_tools.report.example_model import example_with_model
from polar_nav_tools.report.style import TOKENS

NAMES = ('chromium', 'chromium-browser', 'google-chrome', 'google-chrome-stable', 'chrome')
BROWSER = next((path for path in map(shutil.which, NAMES) if path), None)
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(BROWSER is None, reason=f'no browser: none of {", ".join(NAMES)} on PATH'),
]
FLAGS = (
    '--headless',
    '--no-sandbox',
    '--disable-gpu',
    '--disable-quic',
    '--no-first-run',
    '--disable-background-networking',
    '--disable-component-update',
    '--disable-sync',
    '--hide-scrollbars',
    '--enable-logging=stderr',
    '--proxy-server=127.0.0.1:9',  # whatever would be fetched fails
)
# Run in the page; what it finds is read back from the dumped document.
PROBE = """
<script>
addEventListener('load', () => {
  document.querySelectorAll('details').forEach((d) => { d.open = true; });
  const boxes = [...document.querySelectorAll('svg')].map((s) => {
    const r = s.getBoundingClientRect();
    const label = s.getAttribute('aria-label').slice(0, 30);
    return [label, r.width, r.height, s.querySelectorAll('path').length];
  });
  const text = [...document.querySelectorAll('svg text')].map(
    (t) => parseFloat(getComputedStyle(t).fontSize));
  document.body.dataset.probe = JSON.stringify({
    boxes, text, overflow: document.documentElement.scrollWidth - innerWidth,
    images: performance.getEntriesByType('resource').length,
  });
});
</script>
"""


@pytest.fixture(scope='module')
def page(tmp_path_factory):
    path = tmp_path_factory.mktemp('report') / 'report.html'
    path.write_text(render(example_with_model(minutes=4.0)) + PROBE, encoding='utf-8')
    return path


def browse(page, tmp_path, *arguments):
    command = [BROWSER, *FLAGS, f'--user-data-dir={tmp_path / "profile"}', *arguments]
    done = subprocess.run(
        [*command, page.as_uri()], capture_output=True, text=True, timeout=90, check=True
    )
    complaints = [line for line in done.stderr.splitlines() if 'CONSOLE' in line]
    assert complaints == []
    return done.stdout


@pytest.mark.parametrize('width', [1240, 500])
def test_figures_have_their_size(page, tmp_path, width):
    document = browse(page, tmp_path, '--dump-dom', f'--window-size={width},900')
    found = re.search(r'data-probe="([^"]*)"', document)
    probe = json.loads(found.group(1).replace('&quot;', '"').replace('&amp;', '&'))
    assert len(probe['boxes']) == 14
    for label, w, h, paths in probe['boxes']:
        assert w >= 380, label
        assert h >= 150, label
        assert paths > 20, label
    assert probe['overflow'] <= 0
    assert probe['images'] == 0
    assert min(probe['text']) >= 9.0


def picture(page, tmp_path, scheme):
    image = pytest.importorskip('PIL.Image')
    shot = tmp_path / f'{scheme}.png'
    browse(
        page,
        tmp_path,
        f'--screenshot={shot}',
        '--window-size=1240,5600',
        f'--blink-settings=preferredColorScheme={0 if scheme == "dark" else 1}',
    )
    return np.asarray(image.open(shot).convert('RGB'), dtype=np.int16)


@pytest.mark.parametrize('scheme', ['light', 'dark'])
def test_screenshot_shows_the_pictures_in_their_colours(page, tmp_path, scheme):
    pixels = picture(page, tmp_path, scheme)
    assert pixels.shape == (5600, 1240, 3)

    def count(token):
        color = TOKENS[token][scheme == 'dark']
        rgb = np.array([int(color[k : k + 2], 16) for k in (1, 3, 5)])
        return int((np.abs(pixels - rgb).max(2) <= 3).sum())

    assert count('page') > 500_000
    assert count('card') > 1_000_000
    assert count('sea') > 150_000  # the chart
    for token in ('run0', 'run1', 'fused', 'leader', 'fix', 'ink', 'muted'):
        assert count(token) > 100, token
    # The other scheme's grounds are nowhere.
    other = TOKENS['page'][scheme != 'dark']
    rgb = np.array([int(other[k : k + 2], 16) for k in (1, 3, 5)])
    assert (np.abs(pixels - rgb).max(2) == 0).sum() < 5_000

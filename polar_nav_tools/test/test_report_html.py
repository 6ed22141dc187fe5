"""The report as a file: self-contained, complete, themed, small, honest about what is wrong."""

import dataclasses
import re
from html.parser import HTMLParser

import numpy as np
import pytest

from polar_nav_tools.report import Digest, ReportInput, TopicCount, render, write_report
from polar_nav_tools.report.example import example_input
from polar_nav_tools.report.figures import polar_map
from polar_nav_tools.report.story import headline
from polar_nav_tools.report.style import TOKENS, drawing, new_figure
from polar_nav_tools.report.svg import to_svg
from polar_nav_tools.scoring import Balance, compare

DATA = example_input()
SHORT = example_input(minutes=0.5)
VOID = {'meta', 'link', 'br', 'hr', 'img', 'input'}


class Page(HTMLParser):
    """Collects elements; complains about tags that do not match."""

    def __init__(self, text):
        super().__init__()
        self.elements, self.open, self.text = [], [], ''
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        self.elements.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.elements.append((tag, dict(attrs)))

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if not {'script', 'style'} & set(self.open):
            self.text += data

    def all(self, tag):
        return [attrs for name, attrs in self.elements if name == tag]


@pytest.fixture(scope='module')
def text():
    return render(DATA)


@pytest.fixture(scope='module')
def page(text):
    return Page(text)


def test_nothing_is_fetched(text, page):
    for tag, attrs in page.elements:
        for name in ('src', 'href', 'xlink:href', 'action', 'data', 'poster', 'srcset'):
            value = attrs.get(name, '#')
            assert value.startswith(('#', 'data:,')), (tag, name, value)
    outside = set(re.findall(r'[a-z]+://[^\s"\'<>)]+', text))
    # Names of namespaces, not addresses to go to.
    assert outside <= {'http://www.w3.org/2000/svg', 'http://www.w3.org/1999/xlink'}
    assert '@import' not in text
    assert 'url(' not in re.sub(r'url\(#[\w-]+\)', '', text)


def test_ids_are_unique_and_every_reference_has_one(page):
    ids = [attrs['id'] for _, attrs in page.elements if 'id' in attrs]
    assert len(ids) == len(set(ids))
    for _, attrs in page.elements:
        for value in attrs.values():
            for target in re.findall(r'url\(#([^)]+)\)', value or ''):
                assert target in ids
        if attrs.get('href', '').startswith('#'):
            assert attrs['href'][1:] in ids


def test_all_figures_are_there_with_captions_and_labels(page):
    figures = [f['id'] for f in page.all('figure')]
    assert figures == [
        'polar-map',
        'close-up',
        'horizontal-error',
        'position-error-0',
        'velocity-error-0',
        'tilt-error-0',
        'fix-delays',
        'fix-story-0',
        'honesty-0',
    ]
    assert len(page.all('figcaption')) == len(figures)
    svgs = page.all('svg')
    assert len(svgs) == 14  # five of them have one picture for each of two configurations
    for svg in svgs:
        assert svg['role'] == 'img'
        assert len(svg['aria-label']) > 40
        assert re.fullmatch(r'0 0 [\d.]+ [\d.]+', svg['viewbox'])


def test_pictures_come_before_tables(text):
    assert text.rindex('</svg>') < text.index('<table')


def test_colours_follow_the_scheme(text):
    svgs = ''.join(re.findall(r'<svg.*?</svg>', text, re.DOTALL))
    # Whatever is coloured is coloured by a variable of the page, so nothing stays dark at night.
    assert re.findall(r'#[0-9a-fA-F]{3,8}\b', re.sub(r'#[\w-]+-m?\w+', '', svgs)) == []
    used = set(re.findall(r'var\(--([\w-]+)\)', svgs))
    assert used <= set(TOKENS)
    assert {'ink', 'muted', 'run0', 'run1', 'leader', 'fix', 'fused'} <= used
    light = [pair[0] for pair in TOKENS.values()]
    assert len(set(light)) == len(light)
    assert 'prefers-color-scheme: dark' in text
    for token, (day, night) in TOKENS.items():
        assert text.count(f'--{token}: {day};') == 1
        assert text.count(f'--{token}: {night};') == 2  # the system's choice and the button's


def contrast(a, b):
    def luminance(color):
        channels = [int(color[k : k + 2], 16) / 255 for k in (1, 3, 5)]
        linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in channels]
        return float(np.dot(linear, [0.2126, 0.7152, 0.0722]))

    high, low = sorted((luminance(a), luminance(b)), reverse=True)
    return (high + 0.05) / (low + 0.05)


@pytest.mark.parametrize('scheme', [0, 1], ids=['light', 'dark'])
def test_contrast_on_paper_and_at_night(scheme):
    """WCAG: 4.5 for text, 3 for lines and marks."""
    for ground in ('page', 'card', 'sea'):
        below = TOKENS[ground][scheme]
        for token in ('ink', 'muted'):
            assert contrast(TOKENS[token][scheme], below) >= 4.5, (token, ground)
        for token in TOKENS.keys() - {'page', 'card', 'sea', 'rule', 'graticule', 'ink', 'muted'}:
            assert contrast(TOKENS[token][scheme], below) >= 3.0, (token, ground)


def test_size(text):
    assert 200_000 < len(text.encode()) < 3_000_000


def test_numbers_of_the_score_stand_in_the_page(page):
    scores = compare(DATA.runs)
    for one in scores.scores.values():
        assert f'{one.second_half.rms("horizontal"):.3g}' in page.text
    assert 'That is the lag of fusing late fixes as current' in page.text
    assert DATA.digests[0].live in page.text
    for count in DATA.counts:
        assert count.topic in page.text


def test_fixes_have_tooltips(text):
    titles = re.findall(r'<title>([^<]*)</title></use>', text)
    assert sum('FUSED, ' in t and 's old, NIS ' in t for t in titles) > 500
    assert sum('BAD_CRC' in t for t in titles) >= 3


@pytest.mark.slow
def test_same_input_same_bytes(text):
    assert render(example_input()) == text


@pytest.mark.slow
def test_names_are_escaped():
    (truth, estimate, receipts) = SHORT.runs['modified_akf']
    data = ReportInput(
        title='<script>alert(1)</script>',
        subtitle='a & b',
        runs={'<b>x&y</b>': (truth, estimate, receipts)},
        metadata={'<i>': {'<u>': '</dl><script>'}},
    )
    text = render(data)
    assert text.count('<script>') == 1  # the page's own
    for raw in ('<b>x', '<i>', '<u>', 'a & b'):
        assert raw not in text
    Page(text)


@pytest.mark.slow
def test_written_whole_or_not_at_all(tmp_path):
    path = tmp_path / 'new' / 'report.html'
    assert write_report(path, SHORT) == path
    before = path.read_bytes()
    assert before.startswith(b'<!DOCTYPE html>')
    truth, estimate, _ = SHORT.runs['modified_akf']
    broken = dataclasses.replace(SHORT, runs={'a': (truth.rows(slice(0, 0)), estimate, [])})
    with pytest.raises(Exception, match='follower'):
        write_report(path, broken)
    assert path.read_bytes() == before
    assert [p.name for p in path.parent.iterdir()] == ['report.html']


@pytest.mark.slow
def test_what_is_wrong_is_said_at_the_top(text):
    truth, estimate, receipts = SHORT.runs['modified_akf']
    n = len(estimate)
    status = np.where(np.arange(n) >= n // 2, 2, 1).astype(np.uint8)
    r_e = np.where((status == 2)[:, None], np.nan, estimate.r_e)
    data = dataclasses.replace(
        SHORT,
        runs={'lost': (truth, dataclasses.replace(estimate, status=status, r_e=r_e), receipts)},
        balances=[Balance('/follower/acomms/rx', 30, 29)],
        digests=[Digest('nav/state', 'aa', 'bb')],
        counts=[TopicCount('/follower/truth', 10, 9, None), TopicCount('/x', 3, 3, 3)],
    )
    shown = Page(render(data)).text
    for words in (
        'lost gave estimates for 50',
        'lost published 151 estimates as diverged',
        '30 messages were received and 29 have a verdict',
        'nav/state: the replay differs from the live run',
        '/follower/truth: 10 published, 9 recorded, not counted received',
        'No configuration has an estimate in the second half',
    ):
        assert words in shown, words
    assert 'role="alert"' not in text


@pytest.mark.parametrize(
    ('judged', 'lead'),
    [
        ((), 'modified_akf is'),
        (('gone', 'conventional_akf'), 'conventional_akf is'),
        (('modified_akf', 'conventional_akf'), 'modified_akf is'),
    ],
)
def test_what_decides_leads_the_headline(judged, lead):
    text = headline(SHORT.scored(), judged)
    assert f'In the second half, {lead}' in text
    assert 'modified_akf' in text
    assert 'conventional_akf' in text
    assert ('That is the lag' in text) == lead.startswith('modified')


def still(truth):
    return dataclasses.replace(
        truth, r_e=np.repeat(truth.r_e[:1], len(truth), 0), v_G=0.0 * truth.v_G
    )


def shifted(estimate, truth, metres):
    return dataclasses.replace(estimate, r_e=truth.r_e + metres)


TRUTH, ESTIMATE, RECEIPTS = SHORT.runs['modified_akf']
NOT_FUSED = [r for r in RECEIPTS if r.verdict_text != 'FUSED']
NOWHERE = dataclasses.replace(
    ESTIMATE,
    r_e=np.full_like(ESTIMATE.r_e, np.nan),
    v_G=np.full_like(ESTIMATE.v_G, np.nan),
    C_b_G=np.full_like(ESTIMATE.C_b_G, np.nan),
    status=np.full(len(ESTIMATE), 2, np.uint8),
)


@pytest.mark.slow
@pytest.mark.parametrize(
    'runs',
    [
        {'no receipts': (TRUTH, ESTIMATE, [])},
        {'diverged': (TRUTH, NOWHERE, RECEIPTS), 'fine': (TRUTH, ESTIMATE, RECEIPTS)},
        {'one sample': (TRUTH.rows(slice(0, 1)), ESTIMATE.rows(slice(0, 1)), [])},
        *(
            pytest.param(runs, marks=pytest.mark.slow)
            for runs in (
                {'none fused': (TRUTH, ESTIMATE, NOT_FUSED)},
                {'diverged': (TRUTH, NOWHERE, RECEIPTS)},
                {'at rest': (still(TRUTH), shifted(ESTIMATE, TRUTH, 0.1), RECEIPTS)},
                {'perfect': (TRUTH, shifted(ESTIMATE, TRUTH, 0.0), RECEIPTS)},
                {name: (TRUTH, ESTIMATE, RECEIPTS) for name in 'abcdefg'},
            )
        ),
    ],
    ids=', '.join,
)
def test_odd_runs_are_drawn_too(runs):
    page = Page(render(ReportInput(title='odd', runs=runs, sent=SHORT.sent)))
    assert len(page.all('figure')) == 9


@pytest.mark.parametrize(
    ('lat', 'lon', 'words'),
    [
        (80.0, 120.0, 'North Pole'),
        (89.995, 30.0, 'North Pole'),
        (90.0, 0.0, 'North Pole'),
        (-85.0, 179.99, 'South Pole'),
    ],
)
def test_the_map_anywhere(lat, lon, words):
    data = example_input(latitude_deg=lat, longitude_deg=lon, minutes=0.5)
    picture = polar_map(data, data.scored())
    assert words in picture.svg
    assert 'follower and leader' in picture.alt


def test_input_is_checked():
    with pytest.raises(ValueError, match='runs is empty'):
        ReportInput(title='t', runs={})
    with pytest.raises(ValueError, match='comparison is of'):
        ReportInput(title='t', runs={'a': SHORT.runs['modified_akf']}, comparison=SHORT.scored())


def test_tooltips_must_match_markers():
    with drawing('x'):
        fig = new_figure(200, 100)
        ax = fig.add_subplot()
        ax.plot([0, 1, np.nan], [0, 1, 2], ls='', marker='o', gid='tips:a')
        with pytest.raises(ValueError, match='2 markers were drawn, 3 tooltips'):
            to_svg(fig, 'x', 'label', {'a': ['1', '2', '3']})

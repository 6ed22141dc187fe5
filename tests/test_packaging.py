"""What a package index and a package manager want of each package stands in it, and agrees."""

import configparser
import re
import tomllib
import xml.etree.ElementTree as ElementTree
from dataclasses import fields
from pathlib import Path

import pytest

from polar_nav_follower.params import FollowerParams

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = [p.parent for p in sorted(ROOT.glob('polar_nav_*/package.xml'))]
PACKAGES.append(ROOT / 'polar_nav_msgs' / 'tf2_msgs')
LICENCE = (ROOT / 'LICENSE').read_bytes()


def manifest(package):
    return ElementTree.parse(package / 'package.xml').getroot()


def config(package):
    parser = configparser.ConfigParser()
    parser.read(package / 'setup.cfg')
    return parser


def test_all_packages_are_looked_at():
    assert len(PACKAGES) == 8


@pytest.mark.parametrize('package', PACKAGES, ids=lambda p: p.name)
def test_licence_and_addresses(package):
    assert (package / 'LICENSE').read_bytes() == LICENCE
    root = manifest(package)
    (licence,) = root.findall('license')
    assert (licence.text, licence.get('file')) == ('Apache-2.0', 'LICENSE')
    found = {e.get('type'): e.text for e in root.findall('url')}
    assert found.keys() == {'website', 'repository', 'bugtracker'}
    first = {e.get('type'): e.text for e in manifest(PACKAGES[0]).findall('url')}
    assert found == first


@pytest.mark.parametrize('package', PACKAGES, ids=lambda p: p.name)
def test_changelog_is_one_that_catkin_and_bloom_read(package):
    lines = (package / 'CHANGELOG.rst').read_text(encoding='utf-8').splitlines()
    title = f'Changelog for package {package.name}'
    assert lines[:3] == ['^' * len(title), title, '^' * len(title)]
    at = lines.index('Forthcoming')
    assert lines[at + 1] == '-' * len('Forthcoming')
    entries = lines[at + 2 :]
    assert entries
    assert all(line.startswith(('* ', '  ')) for line in entries)


@pytest.mark.parametrize(
    'package', [p for p in PACKAGES if (p / 'setup.cfg').exists()], ids=lambda p: p.name
)
def test_setup_says_what_package_xml_says(package):
    root, setup = manifest(package), config(package)
    for key, tag in {'name': 'name', 'version': 'version', 'license': 'license'}.items():
        assert setup['metadata'][key] == root.findtext(tag)
    assert setup['metadata']['description'] == root.findtext('description')
    urls = {e.get('type'): e.text for e in root.findall('url')}
    assert setup['metadata']['url'] == urls['website']
    share = setup['options.data_files'][f'share/{package.name}'].split()
    assert share == ['package.xml', 'LICENSE', 'CHANGELOG.rst']


def test_licences_of_all_files_are_declared():
    reuse = tomllib.loads((ROOT / 'REUSE.toml').read_text(encoding='utf-8'))
    every, *others = reuse['annotations']
    assert (every['path'], every['SPDX-License-Identifier']) == ('**', 'Apache-2.0')
    named = {path for other in others for path in other['path']}
    own = {p.parent.relative_to(ROOT).as_posix() for p in ROOT.glob('polar_nav_*/**/LICENSE.*')}
    assert {re.sub(r'/[^/]*$', '', path) for path in named} == own


def test_a_mapping_file_states_its_version():
    from polar_nav_ros.adapters.mapping import VERSION

    files = [*ROOT.glob('polar_nav_*/config/*_mapping.yaml')]
    assert len(files) == 3
    for file in files:
        assert re.search(rf'^version: {VERSION}$', file.read_text(), re.MULTILINE), file


def test_the_page_on_security_shows_the_unit_that_is_installed():
    unit = ROOT / 'polar_nav_follower' / 'systemd' / 'polar_nav_follower@.service'
    lines = [text for text in unit.read_text().splitlines() if not text.startswith('#')]
    shown = '\n'.join(f'    {text}' if text else '' for text in lines)
    page = (ROOT / 'docs' / 'security.md').read_text(encoding='utf-8')
    assert f'\n{shown}\n' in page
    parser = configparser.RawConfigParser(strict=False)
    parser.optionxform = str
    parser.read_string(unit.read_text())
    assert set(parser.sections()) == {'Unit', 'Service', 'Install'}
    start = parser['Service']['ExecStart']
    stated = set(re.findall(r'-p (\w+):=', start))
    assert stated <= {f.name for f in fields(FollowerParams)}
    assert 'exec ros2 run polar_nav_follower follower_node ' in start
    # A status that stands for a refused parameter, as of process.run.
    assert parser['Service']['RestartPreventExitStatus'] == '2'


def test_the_page_on_upgrades_names_each_default_that_has_changed():
    from polar_nav_core.engine.version import ENGINE_VERSION
    from polar_nav_core.retired import RETIRED
    from polar_nav_follower.defaults import defaults_of

    page = (ROOT / 'docs' / 'upgrade.md').read_text(encoding='utf-8')
    first, today = defaults_of(1), defaults_of(ENGINE_VERSION)
    changed = {name for name in first if first[name] != today[name]}
    assert len(changed) > 10
    assert {name for name in changed | RETIRED.keys() if f'`{name}`' not in page} == set()

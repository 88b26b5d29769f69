#!/usr/bin/env bash
# Makes three.js, its licence and its hash in this folder from the npm packages three and esbuild, of fixed versions.
set -euo pipefail
three=0.187.0 esbuild=0.28.2
here=$(cd "$(dirname "$0")" && pwd)
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
cp "$here/entry.js" "$work"
cd "$work"
npm init -y >/dev/null
npm install --silent --no-audit --no-fund "three@$three" "esbuild@$esbuild"
npx esbuild entry.js --bundle --format=esm --minify --target=es2022 --legal-comments=inline \
  --banner:js="/* three.js $three, MIT licence, see three.LICENSE; bundled by build.sh */" --outfile="$here/three.js"
cp node_modules/three/LICENSE "$here/three.LICENSE"
cd "$here"
sha256sum three.js >three.js.sha256
cat three.js.sha256

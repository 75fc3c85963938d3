# Creates the list of components of the program from the output of cargo-cyclonedx:
#   jq -f sbom.jq --arg sha SHA256 --arg from FOLDER --arg program NAME --rawfile linked TREE --slurpfile page LIBRARIES BOM
# cargo-cyclonedx lists optional crates too that no feature asks for; TREE is what cargo links, as
# lines "NAME vVERSION". LIBRARIES are those of the page.
($linked | split("\n") | map({(.): true}) | add) as $linked
| .components |= map(select($linked["\(.name) v\(.version)"]))
| ([.metadata.component, .components[]] | map({(."bom-ref"): true}) | add) as $kept
| .dependencies |= map(select($kept[.ref]) | .dependsOn = [.dependsOn[]? | select($kept[.])])
| .metadata.component |= (.name = $program | .hashes = [{alg: "SHA-256", content: $sha}] | del(.components))
| .components += $page
| (.dependencies[] | select(.ref | contains("/bench-daemon#")) | .dependsOn) += ($page | map(."bom-ref"))
# Remove the paths of the source at build time.
| walk(if type == "string" then gsub($from; "") else . end)

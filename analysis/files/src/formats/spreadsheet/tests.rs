//! Sheets as texts, and workbooks that claim more than they contain.

use super::*;

#[test]
fn times_become_clocks() {
    assert_eq!(clock(3723.5), "1:02:3.5");
    assert_eq!(clock(90_000.0), "25:00:0");
    // One third of a second, stored as a fraction of a day, is read without rounding digits.
    assert_eq!(clock(0.25 / 86_400.0 * 86_400.0), "0:00:0.25");
    assert_eq!(duration_s("PT01H02M03.5S"), Some(3723.5));
    assert_eq!(duration_s("PT5S"), Some(5.0));
    assert_eq!(duration_s("5 s"), None);
}

#[test]
fn a_cell_is_one_field_of_one_line() {
    assert_eq!(field(&Data::String("a\tb\nc".to_owned())), "a b c");
    assert_eq!(field(&Data::Float(0.1 + 0.2)), "0.30000000000000004");
    assert_eq!(field(&Data::Float(1e-9)), "0.000000001");
    let mut range = Range::new((2, 1), (3, 2));
    range.set_value((2, 1), Data::Int(7));
    range.set_value((3, 2), Data::Int(8));
    assert_eq!(text(&range).unwrap(), "\n\n\t7\n\t\t8\n");
    let huge = Range::new((1_000_000, 16_000), (1_000_000, 16_000));
    assert!(text(&huge).unwrap_err().contains("export the table as CSV"));
}

fn cells(all: &[((u32, u32), &'static str)]) -> Result<String, String> {
    let mut cells = all.iter();
    of_cells(|| {
        let of =
            |(at, word): &((u32, u32), &'static str)| Cell::new(*at, DataRef::SharedString(word));
        Ok(cells.next().map(of))
    })
}

#[test]
fn cells_become_the_lines_that_a_range_becomes() {
    let all = [((2, 1), "a"), ((3, 2), "b"), ((3, 3), ""), ((5, 0), "c")];
    assert_eq!(cells(&all).unwrap(), "\n\n\ta\n\t\tb\n\nc\n");
    // Cells that are out of order are put in their places.
    let all = [
        ((1, 2), "a"),
        ((1, 0), "b"),
        ((2, 1), "c"),
        ((0, 1), "d"),
        ((2, 4), "e"),
    ];
    assert_eq!(cells(&all).unwrap(), "\td\nb\t\ta\n\tc\t\t\te\n");
    assert_eq!(cells(&[]).unwrap(), "");
    // Two cells at opposite corners of a sheet remain two cells.
    let far = cells(&[((0, 0), "a"), ((1_048_575, 16_383), "b")]).unwrap();
    assert_eq!(far.len(), 1 + 1_048_575 + 16_383 + 2);
}

/// A workbook of Excel with these parts.
fn workbook(sheet: &str, strings: &str) -> Vec<u8> {
    let relations = "http://schemas.openxmlformats.org/officeDocument/2006/relationships";
    let package = "http://schemas.openxmlformats.org/package/2006";
    let main = "http://schemas.openxmlformats.org/spreadsheetml/2006/main";
    let parts = [
        (
            "[Content_Types].xml",
            format!("<Types xmlns=\"{package}/content-types\"/>"),
        ),
        (
            "_rels/.rels",
            format!(
                "<Relationships xmlns=\"{package}/relationships\"><Relationship Id=\"rId1\" \
                 Type=\"{relations}/officeDocument\" Target=\"xl/workbook.xml\"/></Relationships>"
            ),
        ),
        (
            "xl/workbook.xml",
            format!(
                "<workbook xmlns=\"{main}\" xmlns:r=\"{relations}\"><sheets><sheet name=\"S\" \
                 sheetId=\"1\" r:id=\"rId1\"/></sheets></workbook>"
            ),
        ),
        (
            "xl/_rels/workbook.xml.rels",
            format!(
                "<Relationships xmlns=\"{package}/relationships\"><Relationship Id=\"rId1\" \
                 Type=\"{relations}/worksheet\" Target=\"worksheets/sheet1.xml\"/>\
                 <Relationship Id=\"rId2\" Type=\"{relations}/sharedStrings\" \
                 Target=\"sharedStrings.xml\"/></Relationships>"
            ),
        ),
        (
            "xl/worksheets/sheet1.xml",
            format!("<worksheet xmlns=\"{main}\">{sheet}</worksheet>"),
        ),
        (
            "xl/sharedStrings.xml",
            strings.replace("<sst", &format!("<sst xmlns=\"{main}\"")),
        ),
    ];
    packed(
        parts
            .iter()
            .map(|(name, content)| (*name, content.as_bytes())),
    )
}

fn packed<'a>(parts: impl Iterator<Item = (&'a str, &'a [u8])>) -> Vec<u8> {
    let mut archive = zip::ZipWriter::new(Cursor::new(Vec::new()));
    let deflated = zip::write::SimpleFileOptions::default();
    for (name, content) in parts {
        archive.start_file(name, deflated).unwrap();
        archive.write_all(content).unwrap();
    }
    archive.finish().unwrap().into_inner()
}

fn first_sheet_text(bytes: &[u8]) -> Result<String, String> {
    let mut read = sheets(Path::new("x.xlsx"), bytes)
        .expect("a workbook")
        .map_err(|error| error.to_string())?;
    Ok(read.remove(0).text)
}

#[test]
fn a_workbook_that_claims_more_than_can_be_held_is_refused_or_read_as_what_it_holds() {
    let plain = "<sst count=\"1\" uniqueCount=\"1\"><si><t>f</t></si></sst>";
    let far = "<dimension ref=\"A1:XFD1048576\"/><sheetData><row r=\"1\"><c r=\"A1\" t=\"s\">\
               <v>0</v></c></row><row r=\"1048576\"><c r=\"XFD1048576\"><v>2</v></c></row></sheetData>";
    let read = first_sheet_text(&workbook(far, plain)).unwrap();
    assert!(
        read.starts_with("f\n\n") && read.ends_with("\t2\n"),
        "{}",
        read.len()
    );
    let many = plain.replace("uniqueCount=\"1\"", "uniqueCount=\"99999999999999\"");
    let refused = first_sheet_text(&workbook(far, &many)).unwrap_err();
    assert!(
        refused.contains(
            "x.xlsx: expected a spreadsheet that can be decoded: \
                          xl/sharedStrings.xml: it announces 99999999999999 strings"
        ),
        "{refused}"
    );
    // OpenDocument: a row with repeated cells.
    let row = "<table:table-row><table:table-cell table:number-columns-repeated=\"16384\" \
               office:value-type=\"float\" office:value=\"1\"/></table:table-row>";
    let content = format!(
        "<office:document-content><office:body><office:spreadsheet><table:table table:name=\"S\">{}\
         </table:table></office:spreadsheet></office:body></office:document-content>",
        row.repeat(1300)
    );
    let manifest = "<manifest:manifest xmlns:manifest=\"urn\"/>";
    let parts = [
        ("mimetype", OPEN_DOCUMENT.as_bytes()),
        ("META-INF/manifest.xml", manifest.as_bytes()),
        ("content.xml", content.as_bytes()),
    ];
    let bytes = packed(parts.into_iter());
    assert!(bytes.len() < 10_000, "{}", bytes.len());
    let refused = first_sheet_text(&bytes).unwrap_err();
    assert!(
        refused.contains("content.xml: its sheets have more than 20000000"),
        "{refused}"
    );
    // Excel before 2007: a record of dimensions.
    let mut old = MAGIC[1].to_vec();
    old.extend([0; 600]);
    old.extend([
        0, 2, 14, 0, 0, 0, 0, 0, 0xFF, 0xFF, 0xFF, 0xFF, 0, 0, 0xFF, 0xFF, 0, 0,
    ]);
    let refused = first_sheet_text(&old).unwrap_err();
    assert!(
        refused.contains("a sheet that announces 4294967295 rows"),
        "{refused}"
    );
}

#[test]
fn a_sheet_of_open_document_that_breaks_off_is_refused() {
    let whole = "<?xml version=\"1.0\"?><office:document xmlns:office=\"o\" office:mimetype=\"application/vnd.oasis.\
                 opendocument.spreadsheet\"><office:body><office:spreadsheet><table:table table:name=\"S\">\
                 <table:table-row><table:table-cell office:value-type=\"float\" office:value=\"1\"/>\
                 </table:table-row></table:table></office:spreadsheet></office:body></office:document>\n";
    let read = |text: &str| {
        let sheets = sheets(Path::new("x.fods"), text.as_bytes()).unwrap();
        sheets
            .map(|sheets| sheets.len())
            .map_err(|error| error.to_string())
    };
    assert_eq!(read(whole), Ok(1));
    let end = whole.find("</table:table-row>").unwrap();
    for length in [end, end + "</table:table-row>".len(), whole.len() - 3] {
        let refused = read(&whole[..length]).unwrap_err();
        assert!(
            refused.contains("it breaks off before the end"),
            "{refused}"
        );
    }
}
